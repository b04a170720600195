"""Fixed-lag smoothing: each pose of the wheel filter corrected by the measurements of some later seconds.

Of each waiting pose the covariance C with the present states is known, and is propagated like a row of their
covariance: by a transition F to C F', by a measurement with the whitened innovation e, Jacobian W and gain K
to C (I - K W)'. The measurement corrects the pose by C W' e and its covariance by -C W' W C' (fixed-point
smoothing, Meditch 1969). Only five rows belong to a pose, so a longer lag costs little.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.outage_bridge import OutageEnd
from hubodo.fuse.wheel.records import (
    POSE_ENTRIES,
    MeasurementTerms,
    Pose,
    SlipSchedule,
    SmoothingTerms,
    StateChange,
    StepInput,
)


class FixedLagSmoother:
    """Smoother that delays poses by `lag` steps, to correct them; a lag of 0 leaves them unchanged."""

    def __init__(self, lag: int, pose_columns: list[int]) -> None:
        self._lag, self._pose_columns = lag, pose_columns
        self._poses: deque[Pose] = deque()
        self._rows = np.empty((0, 0, 0))
        self._means = np.empty((0, len(POSE_ENTRIES)))
        self._covariances = np.empty((0, len(POSE_ENTRIES), len(POSE_ENTRIES)))

    def add(self, pose: Pose, terms: SmoothingTerms) -> Pose | None:
        """Add the newest step and return the pose of `lag` steps before, or None."""
        if self._lag == 0:
            return pose
        if self._poses:
            for change in terms.changes:
                self._propagate(change)
        rows = terms.pose_rows
        self._poses.append(pose)
        self._rows = np.concatenate([self._rows.reshape(-1, *rows.shape), rows[None]])
        self._means = np.concatenate([self._means, np.array(pose[1:6])[None]])
        covariance = rows[:, self._pose_columns] + terms.heading_inflation
        self._covariances = np.concatenate([self._covariances, covariance[None]])
        return self._pop_oldest() if len(self._poses) > self._lag else None

    def finish(self) -> list[Pose]:
        """Return the remaining poses, which have fewer steps after them."""
        return [self._pop_oldest() for _ in range(len(self._poses))]

    def _propagate(self, change: StateChange) -> None:
        """Propagate the waiting poses through a change of the states."""
        count, size, states = self._rows.shape
        flat = self._rows.reshape(-1, states)
        if isinstance(change, MeasurementTerms):
            by_innovation = flat @ change.jacobian.T
            flat -= by_innovation @ change.gain_root
            self._means += (by_innovation @ change.innovation).reshape(count, size)
            by_innovation = by_innovation.reshape(count, size, -1)
            self._covariances -= by_innovation @ by_innovation.transpose(0, 2, 1)
        else:
            flat[:, change.selection] = flat @ change.rows(states).T

    def _pop_oldest(self) -> Pose:
        """Remove and return the oldest waiting pose."""
        x, y, heading, speed, yaw_rate = self._means[0].tolist()
        covariance = 0.5 * (self._covariances[0] + self._covariances[0].T)
        self._rows, self._means = self._rows[1:], self._means[1:]
        self._covariances = self._covariances[1:]
        return self._poses.popleft()._replace(
            x=x, y=y, heading=heading, speed=speed, yaw_rate=yaw_rate, covariance=covariance
        )


def smooth_with_lag(
    config: WheelConfig,
    steps: Sequence[StepInput],
    alignment_windows: int,
    lag: int,
    slips: SlipSchedule,
    outage_ends: Mapping[int, OutageEnd],
) -> list[Pose]:
    """Return the poses of all steps, each from the log up to `lag` steps after it.

    alignment_windows: as in the first pass. slips, outage_ends: results of the first pass.
    """
    core = FilterCore(config, slips, outage_ends, smoothing=lag > 0)
    smoother = FixedLagSmoother(lag, core.pose_columns)
    core.align([step.windows for step in steps if not step.realign])
    poses = []
    for step in steps:
        pose = core.step(step, alignment_windows)
        smoothed = smoother.add(pose, core.newest_terms) if lag else pose
        poses += [] if smoothed is None else [smoothed]
    return poses + smoother.finish()
