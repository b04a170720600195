"""One row of the table of faults."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """A fault with its expected outcome; tests: `file::test` below tests/, all of which must pass."""

    what: str
    expected: str
    reported_by: str
    tests: tuple[str, ...]
