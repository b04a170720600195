"""The parser of the command line: an error is one line, and exit code 2."""

from __future__ import annotations

import argparse
from typing import NoReturn

EXIT_REFUSED = 2


class UsageError(SystemExit):
    """A command line that no verb accepts; ends the program with EXIT_REFUSED where nobody shows it."""

    def __init__(self, text: str) -> None:
        super().__init__(EXIT_REFUSED)
        self.text = text


class Parser(argparse.ArgumentParser):
    """As argparse's, but for how it refuses."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError with what is wrong and where help is."""
        line = " ".join(message.split())
        raise UsageError(f"{self.prog}: {line}; see {self.prog} --help")
