"""The last stretch of an odometry that is still coming in."""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.steps import CutPath, OdometryPath, StepNoise, cut_path

Pose = tuple[float, float, float, float]
"""t s, x m, y m, heading rad."""


@dataclass(slots=True)
class Trail:
    """Poses by increasing time, and the covariance (3, 3) of what is random in the way to each.

    The covariance is as OdometryPath's; None where the odometry does not say.
    """

    _poses: deque[Pose] = field(default_factory=deque)
    _covariances: deque[Array | None] = field(default_factory=deque)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def newest(self) -> float:
        """s; -inf before the first pose."""
        return self._poses[-1][0] if self._poses else -np.inf

    def add(self, pose: Pose, covariance: Array | None) -> None:
        """One more pose."""
        self._poses.append(pose)
        self._covariances.append(covariance)

    def forget(self, before: float) -> None:
        """Leaves out what is older, but for one pose before that time."""
        while len(self._poses) > 2 and self._poses[1][0] <= before:
            self._poses.popleft()
            self._covariances.popleft()

    def path(self, begin: float) -> OdometryPath:
        """The odometry since `begin`, with one pose before it."""
        count = 0
        for t, *_ in reversed(self._poses):
            count += 1
            if t <= begin:
                break
        first = len(self._poses) - count
        rows = np.array(list(itertools.islice(self._poses, first, None)))
        known = list(itertools.islice(self._covariances, first + 1, None))
        said = [covariance for covariance in known if covariance is not None]
        t, x, y, heading = rows.T
        return OdometryPath(t, x, y, heading, np.array(said) if said and len(said) == len(known) else None)

    def cut(self, begin: float, end: float, noise: StepNoise) -> CutPath:
        """The stretch between two times."""
        return cut_path(self.path(begin), np.array([begin, end]), noise)
