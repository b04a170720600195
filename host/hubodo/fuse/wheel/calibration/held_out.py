"""Does a calibration make stretches better that it was not made from?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.calibration.alignment import position_errors
from hubodo.fuse.wheel.calibration.positions import Positions
from hubodo.fuse.wheel.track import WheelTrack

_STRETCHES = 4
"""Parts of a drive that are left out in turn; fewer teach too little, more hardly drift. Estimated."""

_LEAST = 20.0
"""m of a stretch in which odometry drifts by more than positions are off. Estimated."""

Antenna = tuple[float, float]


@dataclass(frozen=True)
class ErrorSummary:
    """Of a track from positions, m: the median, in which one bad stretch does not count, and the rms."""

    median: float
    rms: float


@dataclass(frozen=True)
class HeldOutErrors:
    """How far stretches are from their positions before, and after calibration from the others.

    Each stretch is laid on its positions. stretches: how many there were; 0 where the drive is too short to
    be divided.
    """

    before: ErrorSummary
    after: ErrorSummary
    stretches: int

    @property
    def is_improved(self) -> bool:
        """Whether calibration made them better by either measure, or nothing can be said."""
        better = self.after.median < self.before.median or self.after.rms < self.before.rms
        return self.stretches == 0 or better

    @property
    def description(self) -> str:
        """In figures."""
        before, after = self.before, self.after
        return (
            f"{before.median:.3f} m from their positions before, {after.median:.3f} m after; "
            f"rms {before.rms:.3f} m, {after.rms:.3f} m"
        )


def measure_held_out_errors(
    told: Positions,
    plain: WheelTrack,
    fitted: Callable[[Positions, float], tuple[WheelTrack, Antenna]],
    antenna: Antenna,
) -> HeldOutErrors:
    """Judged on each of four stretches in turn.

    plain: the track without a calibration; fitted: the track, until a time, s, at least, of a filter
    calibrated on other positions, which it was not told, and its antenna; antenna: m, for the plain track.
    """
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(told.x), np.diff(told.y)))])
    if way[-1] < _STRETCHES * _LEAST or len(told) < 10 * _STRETCHES:
        return HeldOutErrors(ErrorSummary(0.0, 0.0), ErrorSummary(0.0, 0.0), 0)
    part = np.minimum((way / way[-1] * _STRETCHES).astype(int), _STRETCHES - 1)
    before: list[Array] = []
    after: list[Array] = []
    for number in range(_STRETCHES):
        left_out = told.select(part == number)
        track, its_antenna = fitted(told.select(part != number), float(left_out.t[-1]))
        before.append(position_errors(plain, left_out, antenna))
        after.append(position_errors(track, left_out, its_antenna))
    return HeldOutErrors(_distances(before), _distances(after), _STRETCHES)


def _distances(errors: list[Array]) -> ErrorSummary:
    every = np.concatenate(errors)
    return ErrorSummary(float(np.median(every)), float(np.sqrt(np.mean(every**2))))
