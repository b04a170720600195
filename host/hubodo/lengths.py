"""Lengths as people write them, such as `33 cm`, `13 in` or `0.55 m`."""

from __future__ import annotations

import math
import re

from hubodo.errors import InputError

_METRES = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "in": 0.0254,
    "inch": 0.0254,
    "inches": 0.0254,
    '"': 0.0254,
    "ft": 0.3048,
    "'": 0.3048,
}
_PATTERN = re.compile(r"\s*(\d+(?:[.,]\d+)?|[.,]\d+)\s*(m|cm|mm|inches|inch|in|ft|\"|')\s*", re.IGNORECASE)

_FEET_AND_INCHES = re.compile(
    r"\s*(\d+)\s*(?:ft|')\s*(\d+(?:[.,]\d+)?)\s*(?:inches|inch|in|\"|'')?\s*", re.IGNORECASE
)


def parse_length(text: str, what: str) -> float:
    """Return a length in metres.

    what: name of the length, for errors. Raises InputError if the text is not a length.
    """
    if both := _FEET_AND_INCHES.fullmatch(text):
        text = f"{12.0 * float(both[1]) + float(both[2].replace(',', '.'))} in"
    match = _PATTERN.fullmatch(text)
    if match is None:
        raise InputError(f"{what} {text[:40]!r}: write a number and its unit, such as 33 cm, 13 in, 0.55 m")
    value = float(match[1].replace(",", ".")) * _METRES[match[2].lower()]
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{what} {text[:40]!r}: must be above 0")
    return float(f"{value:.9g}")  # 0.165, not 0.16500000000000001


def format_length(metres: float) -> str:
    """Return a length as text: below 1 m in centimetres, else in metres."""
    return f"{100.0 * metres:.4g} cm" if metres < 1.0 else f"{metres:.4g} m"
