"""Cross-validation of a calibration on held-out segments of the drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.track import Track
from hubodo.fuse.wheel.calibration.alignment import position_errors
from hubodo.fuse.wheel.calibration.positions import Positions

_HELD_OUT_SEGMENTS = 4
"""Segments held out in turn; with fewer the rest teaches too little, with more they hardly drift. Estimated.
"""

_MIN_SEGMENT_LENGTH = 20.0
"""m of a segment in which odometry drifts by more than the position error. Estimated."""

Antenna = tuple[float, float]
"""Position of the antenna on the vehicle, m forward and left."""


@dataclass(frozen=True)
class ErrorSummary:
    """Errors of a track against positions, m: median (robust to one bad segment) and rms."""

    median: float
    rms: float


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors on held-out segments before and after calibration on the others.

    Each segment is aligned with its positions. n_segments: 0 if the drive is too short.
    """

    before: ErrorSummary
    after: ErrorSummary
    n_segments: int

    @property
    def is_improved(self) -> bool:
        """Return True if calibration reduced the median or the rms, or if there are no segments."""
        better = self.after.median < self.before.median or self.after.rms < self.before.rms
        return self.n_segments == 0 or better

    @property
    def description(self) -> str:
        """Return the figures as text."""
        before, after = self.before, self.after
        return (
            f"{before.median:.3f} m from their positions before, {after.median:.3f} m after; "
            f"rms {before.rms:.3f} m, {after.rms:.3f} m"
        )


def measure_held_out_errors(
    positions: Positions,
    plain: Track,
    fitted: Callable[[Positions, float], tuple[Track, Antenna]],
    antenna: Antenna,
) -> HeldOutErrors:
    """Return the errors on each of four segments, calibrated on the other three.

    plain: track without calibration. fitted: function that calibrates on given positions and returns the
    track (until a time, s) and the antenna. antenna: m, for the plain track.
    """
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(positions.x), np.diff(positions.y)))])
    if distance[-1] < _HELD_OUT_SEGMENTS * _MIN_SEGMENT_LENGTH or len(positions) < 10 * _HELD_OUT_SEGMENTS:
        return HeldOutErrors(ErrorSummary(0.0, 0.0), ErrorSummary(0.0, 0.0), 0)
    segment_index = np.minimum(
        (distance / distance[-1] * _HELD_OUT_SEGMENTS).astype(int), _HELD_OUT_SEGMENTS - 1
    )
    before: list[Array] = []
    after: list[Array] = []
    for number in range(_HELD_OUT_SEGMENTS):
        segment = positions.select(segment_index == number)
        track, fitted_antenna = fitted(positions.select(segment_index != number), float(segment.t[-1]))
        before.append(position_errors(plain, segment, antenna))
        after.append(position_errors(track, segment, fitted_antenna))
    return HeldOutErrors(_summarise(before), _summarise(after), _HELD_OUT_SEGMENTS)


def _summarise(errors: list[Array]) -> ErrorSummary:
    errors_m = np.concatenate(errors)
    return ErrorSummary(float(np.median(errors_m)), float(np.sqrt(np.mean(errors_m**2))))
