"""Command line of the scripts that print measured figures."""

from __future__ import annotations

import argparse


def script_parser(description: str | None, **whole_numbers: int) -> argparse.ArgumentParser:
    """Return a parser with the docstring of a script as its help, and options by name with their defaults."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in whole_numbers.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=int, default=default)
    return parser
