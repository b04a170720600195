"""Fixed-lag smoothing: each pose of the wheel filter corrected by the measurements of some later seconds.

x_k|j = x_k|j-1 + A (x_j|j - x_j|j-1), P_k|j = P_k|j-1 + A (P_j|j - P_j|j-1) A', A = G_k ... G_j-1, with the
gains G of Rauch, Tung and Striebel (1965): the smoothed states of step k given the measurements up to step j.
Only the five rows of A that belong to a pose are computed, so a longer lag costs little.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg.lapack import dposv

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.outage_bridge import OutageEnd
from hubodo.fuse.wheel.records import POSE_ENTRIES, Pose, SmoothingTerms, StepInput, add_common_scale
from hubodo.fuse.wheel.slip_schedule import SlipSchedule

_CORRELATION_REGULARISATION = 1e-10
"""Added to correlations of 1: far above the rounding of a covariance, 1e-16 over up to a hundred steps."""


class FixedLagSmoother:
    """Smoother that delays poses by `lag` steps, to correct them; a lag of 0 leaves them unchanged."""

    def __init__(self, lag: int, pose_columns: list[int]) -> None:
        self._lag, self._pose_columns = lag, pose_columns
        self._poses: deque[Pose] = deque()
        self._last_terms: SmoothingTerms | None = None
        self._rows = np.empty((0, 0, 0))
        self._means = np.empty((0, len(POSE_ENTRIES)))
        self._covariances = np.empty((0, len(POSE_ENTRIES), len(POSE_ENTRIES)))

    def add(self, pose: Pose, terms: SmoothingTerms) -> Pose | None:
        """Add the newest step and return the pose of `lag` steps before, or None."""
        if self._lag == 0:
            return pose
        if self._last_terms is not None:
            self._correct(terms, smoother_gain(self._last_terms, terms))
        rows = terms.transition[self._pose_columns]
        self._poses.append(pose)
        self._rows = np.concatenate([self._rows.reshape(-1, *rows.shape), rows[None]])
        self._means = np.concatenate([self._means, np.array(pose[1:6])[None]])
        covariance = rows @ terms.p @ rows.T
        covariance[:2, :2] += terms.heading_inflation
        self._covariances = np.concatenate([self._covariances, covariance[None]])
        self._last_terms = terms
        return self._pop_oldest() if len(self._poses) > self._lag else None

    def finish(self) -> list[Pose]:
        """Return the remaining poses, which have fewer steps after them."""
        return [self._pop_oldest() for _ in range(len(self._poses))]

    def _correct(self, terms: SmoothingTerms, gain: Array) -> None:
        """Correct the waiting poses by the measurements of a step."""
        count, size, states = self._rows.shape
        flat = self._rows.reshape(-1, states) @ gain
        self._rows = flat.reshape(count, size, states)
        self._means += (flat @ (np.array(terms.x) - np.array(terms.prior_x))).reshape(count, size)
        change = (flat @ (terms.p - terms.prior_p)).reshape(count, size, states)
        self._covariances += change @ self._rows.transpose(0, 2, 1)

    def _pop_oldest(self) -> Pose:
        """Remove and return the oldest waiting pose."""
        x, y, heading, speed, yaw_rate = self._means[0].tolist()
        covariance = 0.5 * (self._covariances[0] + self._covariances[0].T)
        self._rows, self._means = self._rows[1:], self._means[1:]
        self._covariances = self._covariances[1:]
        return self._poses.popleft()._replace(
            x=x, y=y, heading=heading, speed=speed, yaw_rate=yaw_rate, covariance=covariance
        )


def smoother_gain(before: SmoothingTerms, after: SmoothingTerms) -> Array:
    """Return the gain G (n, n) of the backward step: P F' over the prior covariance of the later step.

    States without variance and states that were reset carry no information about the past.
    """
    forward = before.transition.copy()
    if after.outage_transition is not None:
        forward = after.outage_transition @ forward
    forward[list(after.reset_states)] = 0.0
    if after.speed_row is not None:
        column, derivatives = after.speed_row
        forward[column] = derivatives @ forward
    variance, across = after.prior_p.diagonal(), forward @ before.p
    variable = np.flatnonzero(variance > 0.0)
    if len(variable) == len(variance):
        return _correlation_gain(after.prior_p, across)
    gain = np.zeros_like(after.prior_p)
    gain[:, variable] = _correlation_gain(after.prior_p[np.ix_(variable, variable)], across[variable])
    return gain


def _correlation_gain(p: Array, across: Array) -> Array:
    """Return across' p^-1 (n, m), by the correlations of p (m, m), of which none has variance 0."""
    sigma = np.sqrt(p.diagonal())
    correlation = p / (sigma * sigma[:, None])
    correlation.ravel()[:: len(p) + 1] += _CORRELATION_REGULARISATION
    # cho_factor and cho_solve take as long for their checks as LAPACK takes for the solution.
    _, solution, failed_minor = dposv(correlation, across / sigma[:, None], lower=True)
    if failed_minor:
        raise np.linalg.LinAlgError(f"covariance before a step: minor {failed_minor} is not positive")
    gain: Array = (solution / sigma[:, None]).T
    return gain


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
    core = FilterCore(config, slips, outage_ends, smoothing=True)
    smoother = FixedLagSmoother(lag, core.pose_columns)
    core.align([step.windows for step in steps if not step.realign])
    poses = []
    for step in steps:
        pose = core.step(step, alignment_windows)
        terms = core.history.newest.smoothing
        assert terms is not None
        smoothed = smoother.add(pose, terms)
        poses += [] if smoothed is None else [smoothed]
    return [add_common_scale(pose, core.common_scale_sigma) for pose in poses + smoother.finish()]
