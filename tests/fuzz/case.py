"""One input of a fuzzed command: files beside each other, and the command line that reads them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """An input; words: the command, with FOLDER for the folder of the files; files: content by name."""

    words: tuple[str, ...]
    files: dict[str, bytes]


class Defect(AssertionError):
    """Raised for a case that violates a property that holds for every input."""
