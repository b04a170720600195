"""The record of one vertical gyro axis, and standstills in it."""

from __future__ import annotations

from dataclasses import dataclass

from hubodo.arrays import Array

Spans = tuple[tuple[int, int], ...]
"""Index of the first sample and one past the last of each standstill."""


@dataclass(frozen=True)
class VerticalAxis:
    """The record of one vertical gyro axis.

    Attributes:
        t: (N,) s.
        rate: (N,) anticlockwise seen from above, rad/s, calibrated except for warm-up and turn-on bias.
        raw: (N,) the same without calibration, rad/s.
        temperature: (N,) °C or None.
    """

    t: Array
    rate: Array
    raw: Array
    temperature: Array | None = None
