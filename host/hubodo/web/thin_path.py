"""A path of any length represented by a bounded number of points."""

from __future__ import annotations

import math

_MAX_PATH_POINTS = 2000
_INITIAL_STEP_M = 0.02
"""Smallest distance between points; it doubles each time the path is thinned."""


class ThinnedPath:
    """A path whose `points` are [x, y], the newest last; when it is full, every other point is removed."""

    def __init__(self) -> None:
        self.points: list[list[float]] = []
        self._step = _INITIAL_STEP_M

    def add(self, x: float, y: float) -> None:
        """Add a point if it is far enough from the last one."""
        if self.points and math.dist(self.points[-1], (x, y)) < self._step:
            return
        self.points.append([x, y])
        if len(self.points) > _MAX_PATH_POINTS:
            self.points = self.points[::2]
            self._step *= 2.0
