"""The last stretch of an odometry that is still coming in."""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from hubodo.fuse.graph.steps import CutPath, OdometryPath, StepNoise, cut_path

Pose = tuple[float, float, float, float]
"""t s, x m, y m, heading rad."""


@dataclass(slots=True)
class Trail:
    """Poses by increasing time, and how loose the way to each is, as OdometryPath's, m²."""

    _poses: deque[Pose] = field(default_factory=deque)
    _loose: deque[float] = field(default_factory=deque)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def newest(self) -> float:
        """s; -inf before the first pose."""
        return self._poses[-1][0] if self._poses else -np.inf

    def add(self, pose: Pose, loose: float) -> None:
        """One more pose."""
        self._poses.append(pose)
        self._loose.append(loose)

    def forget(self, before: float) -> None:
        """Leaves out what is older, but for one pose before that time."""
        while len(self._poses) > 2 and self._poses[1][0] <= before:
            self._poses.popleft()
            self._loose.popleft()

    def path(self, begin: float) -> OdometryPath:
        """The odometry since `begin`, with one pose before it."""
        count = 0
        for t, *_ in reversed(self._poses):
            count += 1
            if t <= begin:
                break
        first = len(self._poses) - count
        rows = np.array(list(itertools.islice(self._poses, first, None)))
        loose = np.array(list(itertools.islice(self._loose, first + 1, None)))
        t, x, y, heading = rows.T
        return OdometryPath(t, x, y, heading, loose)

    def cut(self, begin: float, end: float, noise: StepNoise) -> CutPath:
        """The stretch between two times."""
        return cut_path(self.path(begin), np.array([begin, end]), noise)
