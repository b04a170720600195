"""Smoothing of the whole log: Rauch-Tung-Striebel backward pass over the wheel filter.

x_k|N = x_k|k + G (x_k+1|N - x_k+1|k), G = P_k|k F' P_k+1|k^-1 (Rauch, Tung, Striebel 1965). The filter is
rerun in blocks from copies of itself, so that only one block of covariances is in memory. The copies come
from the first pass, or from a second one with the slips and outages that the first has detected.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import WHEEL_ANGLE
from hubodo.fuse.wheel.filter_core import CHECKPOINT_STEPS, FilterCore
from hubodo.fuse.wheel.fixed_lag import smoother_gain
from hubodo.fuse.wheel.records import Pose, SmoothingTerms, StepInput, add_common_scale


def smooth_whole_log(
    first_pass: FilterCore,
    checkpoints: Sequence[FilterCore],
    steps: Sequence[StepInput],
    alignment_windows: int,
) -> list[Pose]:
    """Return the poses of all steps, each from the whole log.

    first_pass: at the end of the log. checkpoints: its copies before every CHECKPOINT_STEPS-th step; needed
    only if its pass is the only one. alignment_windows: as in the first pass.
    """
    if not first_pass.is_single_pass or not checkpoints:
        checkpoints = _run_second_pass(first_pass, steps, alignment_windows)
    core = checkpoints[0]
    angles = [wheel.columns[WHEEL_ANGLE] for wheel in core.wheels]
    poses: list[Pose] = []
    later: SmoothingTerms | None = None
    x, p = np.array(core.x), core.p
    for number in reversed(range(len(checkpoints))):
        block = steps[number * CHECKPOINT_STEPS : (number + 1) * CHECKPOINT_STEPS]
        for pose, terms in reversed(_rerun(checkpoints[number], block, alignment_windows)):
            if later is None:
                x, p = np.array(terms.x), terms.p
            else:
                x, p = smooth_step(terms, later, x, p, angles)
            smoothed = smoothed_pose(pose, terms, x, p, core.pose_columns)
            poses.append(add_common_scale(smoothed, core.common_scale_sigma))
            later = terms
    return poses[::-1]


def _run_second_pass(
    first_pass: FilterCore, steps: Sequence[StepInput], alignment_windows: int
) -> list[FilterCore]:
    """Run the filter with the slips and outages of the first pass; return a copy for each block."""
    core = FilterCore(first_pass.config, first_pass.slip_schedule, first_pass.outage_ends, smoothing=True)
    core.align([step.windows for step in steps if not step.realign])
    copies = []
    for index, step in enumerate(steps):
        if index % CHECKPOINT_STEPS == 0:
            copies.append(copy.deepcopy(core))
        core.step(step, alignment_windows)
    return copies


def _rerun(
    core: FilterCore, steps: Sequence[StepInput], alignment_windows: int
) -> list[tuple[Pose, SmoothingTerms]]:
    """Return pose and smoothing terms of each step."""
    records = []
    for step in steps:
        pose = core.step(step, alignment_windows)
        terms = core.history.newest.smoothing
        assert terms is not None
        records.append((pose, terms))
    return records


def smooth_step(
    terms: SmoothingTerms, later: SmoothingTerms, x: Array, p: Array, angles: Sequence[int]
) -> tuple[Array, Array]:
    """Return the smoothed states after the measurements of a step.

    x, p: smoothed states after the measurements of the `later` step. angles: columns of the wheel angles,
    which are defined modulo one turn.
    """
    gain = smoother_gain(terms, later)
    correction = x - np.array(later.prior_x)
    for angle in angles:
        correction[angle] = math.remainder(correction[angle], 2.0 * math.pi)
    smoothed = terms.p + gain @ (p - later.prior_p) @ gain.T
    return np.array(terms.x) + gain @ correction, 0.5 * (smoothed + smoothed.T)


def smoothed_pose(pose: Pose, terms: SmoothingTerms, x: Array, p: Array, pose_columns: list[int]) -> Pose:
    """Return the pose at the end of a step from its smoothed states."""
    rows = terms.transition[pose_columns]
    change = rows @ (x - np.array(terms.x))
    px, py, heading, speed, yaw_rate = (float(a + b) for a, b in zip(pose[1:6], change, strict=True))
    covariance = rows @ p @ rows.T
    covariance[:2, :2] += terms.heading_inflation
    return pose._replace(x=px, y=py, heading=heading, speed=speed, yaw_rate=yaw_rate, covariance=covariance)
