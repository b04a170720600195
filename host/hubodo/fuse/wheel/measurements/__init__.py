"""The measurements of the wheel filter, one module each; a new one is a module and a line here."""

from typing import Protocol

from hubodo.fuse.wheel.entries import Entry
from hubodo.fuse.wheel.measurements import forward, roll, rolling, sideways, yaw
from hubodo.fuse.wheel.measurements.shared import LinearisedWindow, Row, WheelGeometry, WindowNoise
from hubodo.fuse.wheel.window import Window


class Measurement(Protocol):
    """Interface of a measurement module that is evaluated for every window of every wheel."""

    @property
    def STATES(self) -> tuple[Entry, ...]:
        """Return the entries that the measurement depends on, in the order of its derivatives."""

    def is_usable(self, window: Window) -> bool:
        """Return True if a window with saturated channels is still usable."""

    def measure(self, w: LinearisedWindow, noise: WindowNoise) -> Row:
        """Return residual, variance and derivatives by entry."""


PER_WHEEL: tuple[Measurement, ...] = (yaw, roll, forward, sideways)
"""Measurements of each wheel by itself."""

BETWEEN_WHEELS: tuple[Measurement, ...] = (rolling,)
"""Measurements by which wheels are compared. Their rows come last, so that they are whitened given all
others.
"""

VALID_WHEN_ROLLING: tuple[Measurement, ...] = (forward, sideways, rolling)
"""Measurements that assume rolling without slip."""

MEASUREMENTS = PER_WHEEL + BETWEEN_WHEELS

__all__ = [
    "BETWEEN_WHEELS",
    "MEASUREMENTS",
    "PER_WHEEL",
    "VALID_WHEN_ROLLING",
    "LinearisedWindow",
    "Measurement",
    "Row",
    "WheelGeometry",
    "WindowNoise",
]
