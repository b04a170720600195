"""The measurements of the wheel filter, one file each; a new one is a file and a line here."""

from typing import Protocol

from hubodo.fuse.wheel.entries import Entry
from hubodo.fuse.wheel.measurements import forward, roll, rolling, sideways, yaw
from hubodo.fuse.wheel.measurements.shared import LinearisedWindow, Row, WheelGeometry, WindowNoise
from hubodo.fuse.wheel.window import Window


class Measurement(Protocol):
    """What the file of a measurement holds that is taken from every window of every wheel."""

    @property
    def STATES(self) -> tuple[Entry, ...]:
        """The entries that it sees, in the order of the derivatives."""

    def usable(self, window: Window) -> bool:
        """Whether a window that clipped says anything of it."""

    def measure(self, w: LinearisedWindow, noise: WindowNoise) -> Row:
        """Residual, variance and derivatives by entry."""


PER_WHEEL: tuple[Measurement, ...] = (yaw, roll, forward, sideways)
"""Taken from each wheel by itself."""

BETWEEN_WHEELS: tuple[Measurement, ...] = (rolling,)
"""By these wheels are compared: their rows stand behind all others, so that they are judged given those."""

VALID_WHEN_ROLLING: tuple[Measurement, ...] = (forward, sideways, rolling)
"""Those that take the wheel to roll as the vehicle moves."""

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
