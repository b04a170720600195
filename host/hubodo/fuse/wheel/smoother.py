"""Smoothing of the whole log: Rauch-Tung-Striebel backward pass over the wheel filter.

x_k|N = x_k|k + G (x_k+1|N - x_k+1|k), G = P_k|k F' P_k+1|k^-1 (Rauch, Tung, Striebel 1965). The filter is
rerun in blocks from copies of itself, so that only one block of covariances is in memory.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import WHEEL_ANGLE
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.fixed_lag import smoother_gain
from hubodo.fuse.wheel.outage_bridge import OutageEnd
from hubodo.fuse.wheel.records import Pose, SmoothingTerms, StepInput, add_common_scale
from hubodo.fuse.wheel.slip_schedule import SlipSchedule

_STEPS_IN_MEMORY = 200
"""Steps per block, 10 MB of matrices: about the square root of the steps of an hour, which costs least."""


def smooth_whole_log(
    config: WheelConfig,
    steps: Sequence[StepInput],
    alignment_windows: int,
    slips: SlipSchedule,
    outage_ends: Mapping[int, OutageEnd],
) -> list[Pose]:
    """Return the poses of all steps, each from the whole log.

    alignment_windows: as in the first pass. slips, outage_ends: results of the first pass.
    """
    core = FilterCore(config, slips, outage_ends, smoothing=True)
    core.align([step.windows for step in steps if not step.realign])
    copies = []
    for index, step in enumerate(steps):
        if index % _STEPS_IN_MEMORY == 0:
            copies.append(copy.deepcopy(core))
        core.step(step, alignment_windows)
    angles = [wheel.columns[WHEEL_ANGLE] for wheel in core.wheels]
    poses: list[Pose] = []
    later: SmoothingTerms | None = None
    x, p = np.array(core.x), core.p
    for number in reversed(range(len(copies))):
        block = steps[number * _STEPS_IN_MEMORY : (number + 1) * _STEPS_IN_MEMORY]
        for pose, terms in reversed(_rerun(copies[number], block, alignment_windows)):
            if later is None:
                x, p = np.array(terms.x), terms.p
            else:
                x, p = smooth_step(terms, later, x, p, angles)
            smoothed = smoothed_pose(pose, terms, x, p, core.pose_columns)
            poses.append(add_common_scale(smoothed, core.common_scale_sigma))
            later = terms
    return poses[::-1]


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
