"""Entry point of `python -m hubodo`, for when the command is not on the path."""

import sys

from hubodo.cli import main

if __name__ == "__main__":
    sys.exit(main())
