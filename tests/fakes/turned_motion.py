"""A fake motion of a node on a table, turned by another process."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.emulator.motion import StillMotion

_MAX_TURNS = 64
_CLOCK_ZERO, _NEWEST, _COUNT, _TURNS = 0, 1, 2, 3
"""Places in the file: host time at power-on, s; newest sample, s; number of turns; turns of three values."""


@dataclass(frozen=True)
class TurnedMotion(StillMotion):
    """Motion of a node on a table that turns about z; the processes of board and test share it by a file.

    path: the file. Times are those of the board's clock, s.
    """

    path: Path = field(kw_only=True)

    def __post_init__(self) -> None:
        if not self.path.exists():
            values = np.zeros(_TURNS + 3 * _MAX_TURNS)
            values[_CLOCK_ZERO] = np.inf
            values.tofile(self.path)

    @cached_property
    def _shared(self) -> Array:
        return np.memmap(self.path, np.float64, "r+")

    @cached_property
    def _rng(self) -> np.random.Generator:
        return np.random.default_rng(1)

    @property
    def clock_zero(self) -> float:
        """Return the host time (`time.monotonic`) of power-on, s; infinite before the first sample.

        It is the smallest estimate, as the board's clock is late but never early.
        """
        return float(self._shared[_CLOCK_ZERO])

    @property
    def newest(self) -> float:
        """Return the time of the newest sample, s."""
        return float(self._shared[_NEWEST])

    def add_turn(self, start: float, end: float, rate: float) -> None:
        """Add a turn at `rate`, rad/s."""
        count = int(self._shared[_COUNT])
        self._shared[_TURNS + 3 * count : _TURNS + 3 * count + 3] = start, end, rate
        self._shared[_COUNT] = count + 1

    def angular_rate(self, t: Array) -> Array:
        """Return the (N, 3) rate, rad/s: the turns, with white noise of a gyro."""
        shared, newest = self._shared, float(np.max(t))
        shared[_CLOCK_ZERO] = min(shared[_CLOCK_ZERO], time.monotonic() - newest)
        shared[_NEWEST] = newest
        gyro = self._rng.normal(0.0, 0.002, (len(t), 3))
        for start, end, rate in shared[_TURNS:].reshape(-1, 3)[: int(shared[_COUNT])]:
            gyro[:, 2] += rate * ((t >= start) & (t < end))
        return gyro
