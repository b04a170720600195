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

import numpy as np

from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.records import (
    POSE_ENTRIES,
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
    n_states, size = terms[0].pose_rows.shape[1], len(POSE_ENTRIES)
    later, columns = LaterInformation(n_states), np.array(pose_columns)
    means = np.array([pose[1 : 1 + size] for pose in poses])
    covariances, inflations = np.empty((2, len(poses), size, size))
    for number in range(len(poses) - 1, -1, -1):
        step = terms.pop()
        rows = step.pose_rows
        means[number] += rows.dot(later.vector)
        np.subtract(rows.take(columns, 1), rows.dot(later.matrix).dot(rows.T), covariances[number])
        inflations[number] = step.heading_inflation
        for change in reversed(step.changes):
            later.step_back(change)
    covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
    covariances += inflations
    smoothed = []
    for pose, mean, covariance in zip(poses, means.tolist(), covariances, strict=True):
        x, y, heading, speed, yaw_rate = mean
        smoothed.append(Pose(pose.t, x, y, heading, speed, yaw_rate, covariance, *pose[7:]))
    return smoothed


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
        vector, matrix = self.vector, self.matrix
        if isinstance(change, MeasurementTerms):
            innovation, rows, gain_root = change
            vector += (innovation - gain_root.dot(vector)).dot(rows)
            by_gain = gain_root.dot(matrix)
            added = by_gain.dot(gain_root.T)
            added.ravel()[:: len(added) + 1] += 1.0
            half = added.dot(rows)
            half *= 0.5
            half -= by_gain
        else:
            selected, rows = change.selection, change.rows(len(vector))
            before, by_rows = vector[selected].copy(), matrix[selected].copy()
            vector[selected] = 0.0
            matrix[selected] = 0.0
            matrix[:, selected] = 0.0
            vector += before.dot(rows)
            half = by_rows[:, selected].dot(rows)
            half *= 0.5
            by_rows[:, selected] = 0.0
            half += by_rows
        product = rows.T.dot(half)
        matrix += product + product.T
