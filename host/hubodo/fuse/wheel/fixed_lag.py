"""The wheel track a little late: each pose of the filter improved by what came some seconds after it.

x_k|j = x_k|j-1 + A (x_j|j - x_j|j-1), P_k|j = P_k|j-1 + A (P_j|j - P_j|j-1) A', A = G_k ... G_j-1 with the
gains G of Rauch, Tung and Striebel (1965): what they give for the whole log, as far as j has come. Only
the five rows of A that a pose is made of are carried, so a longer lag costs little.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.records import POSE_ENTRIES, Pose, StepInput, StepRecord
from hubodo.fuse.wheel.slip_schedule import SlipSchedule

_ROUNDING = 1e-10
"""Added to correlations of 1: far above the rounding of a covariance, 1e-16 of up to a hundred steps."""


class FixedLagSmoother:
    """The filter's poses, `lag` steps late.

    Hand each step to `add`: the pose of `lag` steps before comes back, or None; `finish` gives those that had
    fewer steps after them. A lag of 0 gives the poses as they are. pose: places of the pose in the state.
    """

    def __init__(self, lag: int, pose: list[int]) -> None:
        self._lag, self._pose = lag, pose
        self._poses: deque[Pose] = deque()
        self._before: tuple[StepRecord, Array] | None = None
        self._rows = np.empty((0, 0, 0))
        self._mean = np.empty((0, len(POSE_ENTRIES)))
        self._covariance = np.empty((0, len(POSE_ENTRIES), len(POSE_ENTRIES)))

    def add(self, pose: Pose, kept: StepRecord, transition: Array) -> Pose | None:
        """The newest step: its pose, and both sides of its measurements.

        Besides, the transition (n, n) from there to its end.
        """
        if self._lag == 0:
            return pose
        if self._before is not None:
            self._learn(kept, smoother_gain(*self._before, kept))
        rows = transition[self._pose]
        self._poses.append(pose)
        self._rows = np.concatenate([self._rows.reshape(-1, *rows.shape), rows[None]])
        self._mean = np.concatenate([self._mean, np.array(pose[1:6])[None]])
        covariance = rows @ kept.p @ rows.T
        covariance[:2, :2] += kept.heading_inflation
        self._covariance = np.concatenate([self._covariance, covariance[None]])
        self._before = kept, transition
        return self._oldest() if len(self._poses) > self._lag else None

    def finish(self) -> list[Pose]:
        """No more steps come."""
        return [self._oldest() for _ in range(len(self._poses))]

    def _learn(self, kept: StepRecord, step_back: Array) -> None:
        """What the measurements of a step say about the poses that wait."""
        count, size, states = self._rows.shape
        flat = self._rows.reshape(-1, states) @ step_back
        self._rows = flat.reshape(count, size, states)
        self._mean += (flat @ (np.array(kept.x) - np.array(kept.prior_x))).reshape(count, size)
        change = (flat @ (kept.p - kept.prior_p)).reshape(count, size, states)
        self._covariance += change @ self._rows.transpose(0, 2, 1)

    def _oldest(self) -> Pose:
        x, y, heading, speed, yaw_rate = self._mean[0].tolist()
        covariance = 0.5 * (self._covariance[0] + self._covariance[0].T)
        self._rows, self._mean = self._rows[1:], self._mean[1:]
        self._covariance = self._covariance[1:]
        return self._poses.popleft()._replace(
            x=x, y=y, heading=heading, speed=speed, yaw_rate=yaw_rate, covariance=covariance
        )


def smoother_gain(before: StepRecord, transition: Array, after: StepRecord) -> Array:
    """G (n, n) of the step back: P F' over the covariance that the later step began with.

    States without spread there, and those begun anew, tell nothing about the past.
    """
    forward = transition.copy()
    if after.outage_transition is not None:
        forward = after.outage_transition @ forward
    forward[after.reset_states] = 0.0
    if after.speed_row is not None:
        place, by = after.speed_row
        forward[place] = by @ forward
    known = np.flatnonzero(np.diag(after.prior_p) > 0.0)
    scale = np.sqrt(np.diag(after.prior_p)[known])
    alike = after.prior_p[np.ix_(known, known)] / np.outer(scale, scale)
    alike[np.diag_indices(len(known))] += _ROUNDING
    across = (forward @ before.p)[known] / scale[:, None]
    found = np.zeros_like(after.prior_p)
    found[:, known] = (cho_solve(cho_factor(alike, lower=True), across) / scale[:, None]).T
    return found


def smooth_with_lag(
    config: WheelConfig, steps: Sequence[StepInput], alignment_windows: int, lag: int, slips: SlipSchedule
) -> list[Pose]:
    """Poses of all steps, each from the log up to `lag` steps after it.

    needed: windows the filter began with; slips: as it found them, up to two seconds late.
    """
    core = FilterCore(config, slips)
    behind = FixedLagSmoother(lag, core.pose_columns)
    core.records_steps = True
    core.align([step.windows for step in steps if not step.realign])
    poses = []
    for step in steps:
        pose = behind.add(core.step(step, alignment_windows), core.record, core.transition())
        poses += [] if pose is None else [pose]
    return poses + behind.finish()
