"""The parser of the command line: an error is one line, and exit code 2."""

from __future__ import annotations

import argparse
import sys
from typing import NoReturn

EXIT_REFUSED = 2


class Parser(argparse.ArgumentParser):
    """As argparse's, but for how it refuses."""

    def error(self, message: str) -> NoReturn:
        """Says what is wrong and where help is, and ends."""
        line = " ".join(message.split())
        print(f"{self.prog}: {line}; see {self.prog} --help", file=sys.stderr)
        raise SystemExit(EXIT_REFUSED)
