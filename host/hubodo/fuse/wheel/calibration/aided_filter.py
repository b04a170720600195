"""Run of the wheel filter aided by measured positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.calibration.excursions import Jump
from hubodo.fuse.wheel.calibration.positions import Positions
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import ANTENNA_X, ANTENNA_Y, POSITION_ERROR_X, POSITION_ERROR_Y, Entry, X, Y
from hubodo.fuse.wheel.filter import ALIGNMENT_WINDOWS
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.records import SlipSchedule, StepInput
from hubodo.fuse.wheel.window import WINDOW_S

_SPEED_ERROR_SHARE = 0.02
"""Relative error of the distance from a position within a window to the end of the window. Estimated."""

_JUMP_NIS = 16.0
"""Normalised innovation squared of two components beyond which a position has jumped: 1 in 3000."""


_GAP_JUMP_SIGMA, _MIN_JUMP_GAP_S = 1.0, 5.0
"""m by which positions may jump across a gap of at least this many seconds. Estimated."""

_JUMP_COST = 2.0 * math.log(1e4)
"""Cost of a jump in -2 log likelihood: one position in ten thousand is expected to jump. Estimated."""


@dataclass(frozen=True)
class AidedRun:
    """Result of a filter run aided by positions.

    core: the filter after the last step. cost: -2 log likelihood of the positions. n_used: number of
    positions used. jumps: jumps among them.
    """

    core: FilterCore
    cost: float
    n_used: int
    jumps: tuple[Jump, ...]


def run_aided_filter(
    config: WheelConfig,
    steps: Sequence[StepInput],
    positions: Positions,
    white_sigma: Array,
    slow_sigma: float,
    origin: complex,
    slips: SlipSchedule,
) -> AidedRun:
    """Run the steps and update with each position at the end of its window.

    white_sigma: (M,) m of each position; slow_sigma: m of the slowly varying error. origin: x + iy, m, start
    of the first step, without the antenna. slips: slip schedule of the plain run.
    """
    core = FilterCore(
        replace(
            config, position_aided=True, priors={**config.priors, **_aiding_priors(positions, slow_sigma)}
        ),
        slips,
    )
    positions_of_step = _assign_to_steps(steps, positions)
    for entry, value in ((X, origin.real), (Y, origin.imag)):
        column = core.columns.vehicle[entry]
        core.x[column], core.p[column, column] = (
            value,
            (slow_sigma + ANTENNA_X.prior + float(white_sigma[0])) ** 2,
        )
    core.align([step.windows for step in steps if not step.realign])
    cost, count = 0.0, 0
    jumps: list[Jump] = []
    for number, step in enumerate(steps):
        pose = core.step(step, ALIGNMENT_WINDOWS)
        for index in positions_of_step.get(number, ()):
            delay = pose.t - float(positions.t[index])
            distance, mid_heading = pose.speed * delay, pose.heading - 0.5 * pose.yaw_rate * delay
            position_sigma = math.hypot(float(white_sigma[index]), _SPEED_ERROR_SHARE * distance)
            at = Position(
                float(positions.x[index]) + distance * math.cos(mid_heading),
                float(positions.y[index]) + distance * math.sin(mid_heading),
                position_sigma,
            )
            if count and positions.t[index] - positions.t[index - 1] > _MIN_JUMP_GAP_S:
                _reset_slow_error(core, _GAP_JUMP_SIGMA)
            innovation = core.position_innovation(at)
            if innovation.nis > _JUMP_NIS and count:
                jumps.append(Jump(index, complex(*innovation.z)))
                _reset_slow_error(core, abs(jumps[-1].change))
                innovation = core.position_innovation(at)
                cost += _JUMP_COST
            cost += innovation.cost
            core.update_with_position(innovation)
            count += 1
    return AidedRun(core, cost, count, tuple(jumps))


def _aiding_priors(positions: Positions, slow_sigma: float) -> dict[Entry, Quantity]:
    known = {entry: Quantity(0.0, slow_sigma) for entry in (POSITION_ERROR_X, POSITION_ERROR_Y)}
    if positions.antenna is not None:
        x, y, sigma = positions.antenna
        known |= {ANTENNA_X: Quantity(x, sigma), ANTENNA_Y: Quantity(y, sigma)}
    return known


def _assign_to_steps(steps: Sequence[StepInput], positions: Positions) -> dict[int, list[int]]:
    """Return, by step, the positions that lie in its window; positions in outages are left out."""
    positions_of_step = np.array([(step.number + 1) * WINDOW_S for step in steps])
    step_indices = np.searchsorted(positions_of_step, positions.t)
    assigned: dict[int, list[int]] = {}
    for index, column in enumerate(step_indices.tolist()):
        if column < len(steps) and steps[column].windows:
            assigned.setdefault(column, []).append(index)
    return assigned


def _reset_slow_error(core: FilterCore, size: float) -> None:
    """Inflate the slowly varying error of positions that jumped by `size`, m."""
    for entry in (POSITION_ERROR_X, POSITION_ERROR_Y):
        column = core.columns.vehicle[entry]
        core.p[column, column] += size * size
