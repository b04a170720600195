"""The command-line parser, which reports errors in one line with exit code 2."""

from __future__ import annotations

import argparse
from typing import NoReturn

EXIT_REFUSED = 2


class UsageError(SystemExit):
    """An invalid command line; it exits with EXIT_REFUSED unless it is caught and reported."""

    def __init__(self, text: str) -> None:
        super().__init__(EXIT_REFUSED)
        self.text = text


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that raises UsageError instead of printing the usage."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError with the message and a hint at --help."""
        line = " ".join(message.split())
        raise UsageError(f"{self.prog}: {line}; see {self.prog} --help")
