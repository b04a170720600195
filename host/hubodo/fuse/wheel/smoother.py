"""The wheel track seen from the end of the log: Rauch-Tung-Striebel smoothing of the wheel filter.

x_k|N = x_k|k + G (x_k+1|N - x_k+1|k), G = P_k|k F' P_k+1|k^-1 (Rauch, Tung, Striebel 1965). The filter is
run again in stretches from copies of itself, so that only one stretch of covariances is in memory.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import WHEEL_ANGLE
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.fixed_lag import smoother_gain
from hubodo.fuse.wheel.records import Pose, StepInput, StepRecord
from hubodo.fuse.wheel.slip_schedule import SlipSchedule

_STRETCH = 200
"""Steps that are in memory at once, 10 MB of matrices.

About the square root of an hour's, which costs least.
"""


class _Record(NamedTuple):
    """A step: its pose, both sides of its measurements, and the transition from there to its end, (n, n)."""

    pose: Pose
    kept: StepRecord
    transition: Array


def smooth_whole_log(
    config: WheelConfig, steps: Sequence[StepInput], needed: int, slips: SlipSchedule
) -> list[Pose]:
    """Poses of all steps, each from the whole log.

    needed: windows the filter began with; slips: as it found them.
    """
    core = FilterCore(config, slips)
    core.align([step.windows for step in steps if not step.realign])
    copies = []
    for index, step in enumerate(steps):
        if index % _STRETCH == 0:
            copies.append(copy.deepcopy(core))
        core.step(step, needed)
    angles = [wheel.columns[WHEEL_ANGLE] for wheel in core.wheels]
    poses: list[Pose] = []
    later: _Record | None = None
    x, p = np.array(core.x), core.p
    for number in reversed(range(len(copies))):
        stretch = steps[number * _STRETCH : (number + 1) * _STRETCH]
        for record in reversed(_again(copies[number], stretch, needed)):
            if later is None:
                x, p = np.array(record.kept.x), record.kept.p
            else:
                x, p = _step_back(record, later, x, p, angles)
            poses.append(_pose(record, x, p, core.pose_columns))
            later = record
    return poses[::-1]


def _again(core: FilterCore, steps: Sequence[StepInput], needed: int) -> list[_Record]:
    core.records_steps = True
    records = []
    for step in steps:
        pose = core.step(step, needed)
        records.append(_Record(pose, core.record, core.transition()))
    return records


def _step_back(
    record: _Record, later: _Record, x: Array, p: Array, angles: Sequence[int]
) -> tuple[Array, Array]:
    """Smoothed states after `record`'s measurements.

    From those (x, p) after the measurements of the `later` one. angles: places of the wheel angles, which are
    the same a turn further.
    """
    back = smoother_gain(record.kept, record.transition, later.kept)
    ahead = x - np.array(later.kept.prior_x)
    for angle in angles:
        ahead[angle] = math.remainder(ahead[angle], 2.0 * math.pi)
    smoothed = record.kept.p + back @ (p - later.kept.prior_p) @ back.T
    return np.array(record.kept.x) + back @ ahead, 0.5 * (smoothed + smoothed.T)


def _pose(record: _Record, x: Array, p: Array, places: list[int]) -> Pose:
    rows = record.transition[places]
    change = rows @ (x - np.array(record.kept.x))
    pose = record.pose
    px, py, heading, speed, yaw_rate = (float(a + b) for a, b in zip(pose[1:6], change, strict=True))
    covariance = rows @ p @ rows.T
    covariance[:2, :2] += record.kept.heading_inflation
    return pose._replace(x=px, y=py, heading=heading, speed=speed, yaw_rate=yaw_rate, covariance=covariance)
