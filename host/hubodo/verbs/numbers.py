"""Types of numeric options: finite numbers within bounds, with one-line errors."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from hubodo.ingest.live.record_config import MAX_BAUD
from hubodo.toml_file import MAX_TOML_NUMBER


def bounded_number(
    low: float = -MAX_TOML_NUMBER, high: float = MAX_TOML_NUMBER, *, above: float | None = None
) -> Callable[[str], float]:
    """Return the type of an option that takes a number from low to high, and strictly above `above`."""
    bounds = f"from {low:g} to {high:g}"
    if above is not None:
        bounds = f"above {above:g}" + (f", {high:g} at most" if high < MAX_TOML_NUMBER else "")
    elif high == MAX_TOML_NUMBER:
        bounds = "" if low == -MAX_TOML_NUMBER else f"from {low:g} on"

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or (above is not None and value < above + 1.0 / MAX_TOML_NUMBER):
            has_unit = text[:1].isdigit() and text[-1:].isalpha()
            hint = ", without a unit (see --help for it)" if has_unit else ""
            raise argparse.ArgumentTypeError(f"{text[:40]}: write a number {bounds}".rstrip() + hint)
        return value

    return parse


def bounded_integer(low: int, high: int) -> Callable[[str], int]:
    """Return the type of an option that takes an integer from low to high."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text[:40]}: write a whole number from {low} to {high}")
        return value

    return parse


positive_number = bounded_number(above=0.0)
non_negative_number = bounded_number(0.0)
_latitude = bounded_number(-90.0, 90.0)


def latitude(text: str) -> float:
    """Return the value of an option that takes a latitude, degrees."""
    try:
        return _latitude(text)
    except argparse.ArgumentTypeError as error:
        raise argparse.ArgumentTypeError(f"{error}; latitude and longitude may be swapped") from None


baud_rate = bounded_integer(1, MAX_BAUD)
seed = bounded_integer(0, 2**63 - 1)
