"""One row of the table of faults."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """tests: `file::test` below tests/, of which all must pass."""

    what: str
    expected: str
    told_by: str
    tests: tuple[str, ...]
