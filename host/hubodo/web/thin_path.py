"""A path of any length in a bounded number of points."""

from __future__ import annotations

import math

_MOST = 2000
_STEP = 0.02
"""m between points at first; it doubles each time the path is thinned."""


class ThinPath:
    """points: [x, y], the newest last; when there are too many every other one goes."""

    def __init__(self) -> None:
        self.points: list[list[float]] = []
        self._step = _STEP

    def add(self, x: float, y: float) -> None:
        """A point, kept where it is far enough from the one before."""
        if self.points and math.dist(self.points[-1], (x, y)) < self._step:
            return
        self.points.append([x, y])
        if len(self.points) > _MOST:
            self.points = self.points[::2]
            self._step *= 2.0
