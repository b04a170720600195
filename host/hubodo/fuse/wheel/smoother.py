"""Smoothing of the whole log: modified Bryson-Frazier backward pass over the wheel filter.

x_k|N = x_k + P_k l and P_k|N = P_k - P_k L P_k, where l and L hold what all later measurements say about the
states at a pose. A measurement with the whitened innovation e = S^-1/2 z, Jacobian W = S^-1/2 H and gain
K = P W' changes them to

    l = (I - K W)' l + W' e        L = (I - K W)' L (I - K W) + W' W

and a transition F to F' l and F' L F (Bierman, Fixed interval smoothing with discrete measurements, 1973). No
covariance is inverted, and of each P_k only the rows of the pose are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import add

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.records import (
    MeasurementTerms,
    Pose,
    SmoothingTerms,
    StateChange,
    StepInput,
)


def smooth_whole_log(
    poses: Sequence[Pose], terms: list[SmoothingTerms], pose_columns: Sequence[int]
) -> list[Pose]:
    """Return all poses, each from the whole log; empties `terms`, which hold most of the memory of a run."""
    n_states = terms[0].pose_rows.shape[1]
    later, columns = LaterInformation(n_states), np.array(pose_columns)
    smoothed = []
    for pose in reversed(poses):
        step = terms.pop()
        smoothed.append(later.smooth(pose, step, columns))
        for change in reversed(step.changes):
            later.step_back(change)
    return smoothed[::-1]


def run_second_pass(
    first_pass: FilterCore, steps: Sequence[StepInput], alignment_windows: int
) -> tuple[list[Pose], list[SmoothingTerms]]:
    """Run the filter with the slips and outages of the first pass; return pose and terms of each step.

    alignment_windows: as in the first pass.
    """
    core = FilterCore(first_pass.config, first_pass.slip_schedule, first_pass.outage_ends, smoothing=True)
    core.align([step.windows for step in steps if not step.realign])
    poses, terms = [], []
    for step in steps:
        poses.append(core.step(step, alignment_windows))
        terms.append(core.newest_terms)
    return poses, terms


class LaterInformation:
    """Information of the measurements after a time on the states at that time: l (n,) and L (n, n)."""

    def __init__(self, n_states: int) -> None:
        self.vector, self.matrix = np.zeros(n_states), np.zeros((n_states, n_states))

    def step_back(self, change: StateChange) -> None:
        """Propagate the information to before a change of the states."""
        if isinstance(change, MeasurementTerms):
            innovation, jacobian, gain_root = change
            self.vector += (innovation - gain_root.dot(self.vector)).dot(jacobian)
            by_gain = gain_root.dot(self.matrix)
            added = by_gain.dot(gain_root.T)
            added.ravel()[:: len(added) + 1] += 1.0
            half = 0.5 * added.dot(jacobian) - by_gain
            self._add_symmetric(jacobian, half)
            return
        selected, rows = change.selection, change.rows(len(self.vector))
        before, by_rows = np.array(self.vector[selected]), np.array(self.matrix[selected])
        self.vector[selected] = 0.0
        self.matrix[selected] = 0.0
        self.matrix[:, selected] = 0.0
        self.vector += before.dot(rows)
        half = 0.5 * by_rows[:, selected].dot(rows)
        by_rows[:, selected] = 0.0
        half += by_rows
        self._add_symmetric(rows, half)

    def smooth(self, pose: Pose, terms: SmoothingTerms, pose_columns: NDArray[np.intp]) -> Pose:
        """Return the pose at the end of a step with this information."""
        rows = terms.pose_rows
        x, y, heading, speed, yaw_rate = map(add, pose[1:6], rows.dot(self.vector).tolist())
        covariance = rows.take(pose_columns, axis=1) - rows.dot(self.matrix).dot(rows.T)
        covariance = 0.5 * (covariance + covariance.T)
        covariance += terms.heading_inflation
        return Pose(pose.t, x, y, heading, speed, yaw_rate, covariance, *pose[7:])

    def _add_symmetric(self, rows: Array, other: Array) -> None:
        """Add rows' other + other' rows to the matrix."""
        product = rows.T.dot(other)
        self.matrix += product + product.T
