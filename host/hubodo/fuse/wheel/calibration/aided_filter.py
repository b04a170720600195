"""The wheel filter again, told where it was."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.calibration.positions import Positions
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import ANTENNA_X, ANTENNA_Y, POSITION_ERROR_X, POSITION_ERROR_Y, Entry, X, Y
from hubodo.fuse.wheel.filter import ALIGNMENT_WINDOWS
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.records import StepInput
from hubodo.fuse.wheel.slip_schedule import SlipSchedule
from hubodo.fuse.wheel.window import WINDOW_S

_SPEED_SHARE = 0.02
"""Of the speed, by which the way from the end of a window back to a position within it is off. Estimated."""

_GATE = 16.0
"""Squared innovations, of two numbers, beyond which a position has jumped: 1 in 3000 honest ones."""


_UNSEEN, _LONG = 1.0, 5.0
"""m by which positions may have jumped where none was told for so many seconds. Estimated."""

_RARE = 2.0 * math.log(1e4)
"""What a jump costs: one in ten thousand positions is believed to jump. Estimated."""


@dataclass(frozen=True)
class AidedRun:
    """A filter after its drive.

    cost: minus twice the logarithm of the likelihood of the positions; used: how many there were; jumps: how
    often they jumped.
    """

    core: FilterCore
    cost: float
    n_used: int
    n_jumps: int


def run_aided_filter(
    config: WheelConfig,
    steps: Sequence[StepInput],
    told: Positions,
    random: Array,
    slow: float,
    origin: complex,
    slips: SlipSchedule,
) -> AidedRun:
    """Runs the steps with each position worked in at the end of its window.

    random: (M,) m, 1 sigma of what is random in each position; slow: m, 1 sigma of what changes slowly.
    origin: x + iy, m, where the first step begins, but for the antenna. slips: which wheels spin by
    themselves, by number of the window.
    """
    core = FilterCore(
        replace(config, position_aided=True, priors={**config.priors, **_around(told, slow)}), slips
    )
    ends = _at_their_windows(steps, told)
    for entry, value in ((X, origin.real), (Y, origin.imag)):
        place = core.columns.vehicle[entry]
        core.x[place], core.p[place, place] = value, (slow + ANTENNA_X.prior + float(random[0])) ** 2
    core.align([step.windows for step in steps if not step.realign])
    cost, used, jumps = 0.0, 0, 0
    for number, step in enumerate(steps):
        pose = core.step(step, ALIGNMENT_WINDOWS)
        for index in ends.get(number, ()):
            late = pose.t - float(told.t[index])
            way, half = pose.speed * late, pose.heading - 0.5 * pose.yaw_rate * late
            off = math.hypot(float(random[index]), _SPEED_SHARE * way)
            at = Position(
                float(told.x[index]) + way * math.cos(half), float(told.y[index]) + way * math.sin(half), off
            )
            if used and told.t[index] - told.t[index - 1] > _LONG:
                _loosen(core, _UNSEEN)
            innovation = core.position_innovation(at)
            if innovation.nis > _GATE and used:
                jumps += 1
                _loosen(core, float(np.hypot(*innovation.z)))
                innovation = core.position_innovation(at)
                cost += _RARE
            cost += innovation.cost
            core.update_with_position(innovation)
            used += 1
    return AidedRun(core, cost, used, jumps)


def _around(told: Positions, slow: float) -> dict[Entry, Quantity]:
    known = {entry: Quantity(0.0, slow) for entry in (POSITION_ERROR_X, POSITION_ERROR_Y)}
    if told.antenna is not None:
        x, y, sigma = told.antenna
        known |= {ANTENNA_X: Quantity(x, sigma), ANTENNA_Y: Quantity(y, sigma)}
    return known


def _at_their_windows(steps: Sequence[StepInput], told: Positions) -> dict[int, list[int]]:
    """Which positions are worked in after which step: that in whose window they lie, if a wheel was heard."""
    ends = np.array([(step.number + 1) * WINDOW_S for step in steps])
    places = np.searchsorted(ends, told.t)
    found: dict[int, list[int]] = {}
    for index, place in enumerate(places.tolist()):
        if place < len(steps) and steps[place].windows:
            found.setdefault(place, []).append(index)
    return found


def _loosen(core: FilterCore, size: float) -> None:
    """A position that jumped has a new slow error: as far from the old one as it jumped."""
    for entry in (POSITION_ERROR_X, POSITION_ERROR_Y):
        place = core.columns.vehicle[entry]
        core.p[place, place] += size * size
