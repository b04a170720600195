"""One input of a fuzzed command: files beside each other, and the command line that reads them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """words: the command, in which FOLDER stands for the folder of the files. files: content by name."""

    words: tuple[str, ...]
    files: dict[str, bytes]


class Defect(AssertionError):
    """A case that breaks what must hold for every input."""
