"""Glitches: samples of a gyro that jump and return faster than any wheel turns.

A bit error on the bus or a garbled packet gives such samples. At 100 Hz a single one of -33 rad/s turns the
wheel by 0.3 rad more than it did, which costs the wheel its angle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

SampleRow = tuple[float, ...]
"""Gyro x, y, z in rad/s, and further numbers of one sample."""

_MIN_JUMP, _MIN_JUMP_ACCELERATION = 3.0, 300.0
"""rad/s between samples, and rad/s² between slow ones, from which on a sample may be a glitch. Samples of
real wheels jump and return by at most 0.6 rad/s on a car at 120 Hz and 1.5 rad/s on a wheelchair at 400 Hz.
"""
_MIN_STEP_SAMPLES = 4
"""Samples that follow each other smoothly after a jump, from which on the wheel really turns otherwise."""


def find_jumps(t: Array, gyro: Array) -> NDArray[np.bool_]:
    """Return True (N - 1,) where a sample jumps as `is_jump`; t: (N,) s, gyro: (N, 3) rad/s."""
    threshold = np.maximum(_MIN_JUMP, _MIN_JUMP_ACCELERATION * np.diff(t))
    return np.asarray((np.abs(np.diff(gyro, axis=0)) > threshold[:, None]).any(axis=1), np.bool_)


def is_jump(step: float, before: Sequence[float], row: Sequence[float]) -> bool:
    """Return True if the gyros change faster than a wheel does; step: s to the previous sample."""
    threshold = max(_MIN_JUMP, _MIN_JUMP_ACCELERATION * step)
    return (
        abs(row[0] - before[0]) > threshold
        or abs(row[1] - before[1]) > threshold
        or abs(row[2] - before[2]) > threshold
    )


class GlitchFilter:
    """Holds samples after a jump until the rate has returned, or has stayed for `_MIN_STEP_SAMPLES`.

    Attributes
    ----------
    n_rejected : number of samples left out.
    """

    def __init__(self) -> None:
        """Start before the first sample."""
        self.n_rejected = 0
        self._accepted: SampleRow = ()
        self._held: list[tuple[float, SampleRow]] = []

    def restart(self, row: SampleRow) -> None:
        """Accept a sample whatever the ones before; samples that are still held are left out."""
        self.n_rejected += len(self._held)
        self._held = []
        self._accepted = row

    def is_smooth(self, step: float, gyro: Sequence[float]) -> bool:
        """Return True if a sample, `step` s after the newest, follows it without a jump and none is held."""
        return not self._held and not is_jump(step, self._accepted, gyro)

    def add(self, step: float, t: float, row: SampleRow) -> list[tuple[float, SampleRow]]:
        """Add a sample, `step` s after the previous one; return those that are accepted now, in order."""
        if not is_jump(step, self._accepted, row):
            self.restart(row)
            return [(t, row)]
        if self._held and is_jump(step, self._held[-1][1], row):
            self.n_rejected += len(self._held)
            self._held = []
        self._held.append((t, row))
        if len(self._held) < _MIN_STEP_SAMPLES:
            return []
        accepted, self._held, self._accepted = self._held, [], row
        return accepted
