"""Numbers as values of options: finite and within bounds, or refused with what to write."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from hubodo.toml_file import MAX_TOML_NUMBER


def number(
    low: float = -MAX_TOML_NUMBER, high: float = MAX_TOML_NUMBER, *, above: float | None = None
) -> Callable[[str], float]:
    """The type of an option that takes a number from low to high; above: that it must exceed."""
    words = f"from {low:g} to {high:g}"
    if above is not None:
        words = f"above {above:g}" + (f", {high:g} at most" if high < MAX_TOML_NUMBER else "")
    elif high == MAX_TOML_NUMBER:
        words = "" if low == -MAX_TOML_NUMBER else f"from {low:g} on"

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or (above is not None and value < above + 1.0 / MAX_TOML_NUMBER):
            raise argparse.ArgumentTypeError(f"{text[:40]}: write a number {words}".rstrip())
        return value

    return read


def whole(low: int, high: int) -> Callable[[str], int]:
    """The type of an option that takes a whole number from low to high."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text[:40]}: write a whole number from {low} to {high}")
        return value

    return read


positive = number(above=0.0)
not_negative = number(0.0)
latitude = number(-90.0, 90.0)
baud = whole(1, 50_000_000)
seed = whole(0, 2**63 - 1)
