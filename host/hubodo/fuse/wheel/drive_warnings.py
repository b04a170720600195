"""What a user must know of a drive that the wheel filter went through."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.window import WINDOW_S

START_WINDOWS = int(3.0 / WINDOW_S)
"""Windows in which a drive is expected to rest; behind them it counts only whether it ever did."""
_TURN = 2.0 * math.pi


def list_warnings(wheel_filter: WheelFilter, motion_states: Array) -> list[str]:
    """What a user must know of a drive so far; still: (N,) of the poses."""
    lines = []
    beginning = motion_states[:START_WINDOWS]
    if not np.any(beginning != MotionState.MOVING):
        lines.append(
            "no rest at the start: gyro biases had to be found while driving; the heading is less sure for "
            "the first turns of the wheel. Stand still for five seconds before driving off"
        )
    elif not np.any(beginning == MotionState.STANDSTILL) and not np.any(
        motion_states == MotionState.STANDSTILL
    ):
        lines.append("the vehicle was rocked at the start, never quite still: gyro biases are less sure")
    if wheel_filter.core.mounting_check.verdict:
        lines.append(f"{wheel_filter.core.mounting_check.verdict}; until then its speed is not used")
    lines += wheel_filter.core.outages.list_warnings(
        " and ".join(wheel.name for wheel in wheel_filter.core.wheels)
    )
    windows, silent = wheel_filter.core.windows, wheel_filter.core.outages.windows
    for wheel in wheel_filter.core.wheels:
        lines += _wheel_warnings(wheel, windows, silent, wheel_filter.refused[wheel.name])
    return lines


def _wheel_warnings(wheel: Wheel, windows: int, silent: int, refused: int) -> list[str]:
    whole = windows * WINDOW_S
    if wheel.missing_windows >= windows:
        return [f"{wheel.name}: no samples; the track comes from the other wheel alone"]
    found = []
    if wheel.missing_windows - silent > 5:
        gone = wheel.missing_windows * WINDOW_S
        found.append(f"not heard for {gone:.1f} s of {whole:.1f} s; sigmas grow there")
    if wheel.angle_losses:
        found.append(
            f"the wheel angle was lost over a gap and found anew ({wheel.angle_losses} times): "
            "its clock jumped, or it turned on while it was not heard"
        )
    if refused:
        found.append(
            f"{refused} samples left out because their time went back, or jumped ahead for one of them"
        )
    if wheel.turned_angle < _TURN:
        turns = wheel.turned_angle / _TURN
        found.append(f"the wheel turned only {turns:.2f} times; scale, tilt and lever arm stay unknown")
    elif rolled_mostly_backwards(wheel):
        found.append(
            "rolled backwards nearly all the way; if the vehicle drove forwards, the node faces the other "
            "way: change its facing"
        )
    if wheel.upright_count >= 50 and wheel.upright_sum < 0.5 * wheel.upright_count:
        found.append("gravity does not turn with gz; an axis is mirrored, or the node is not on the wheel")
    if wheel.clipped_windows:
        limit = wheel.clipped_windows * WINDOW_S
        found.append(f"gz at its limit for {limit:.1f} s; spin there is from gravity and centripetal force")
    if wheel.outlier_windows > max(5, 0.05 * windows):
        lost = wheel.outlier_windows * WINDOW_S
        found.append(f"disagreed with the other wheel for {lost:.1f} s and lost weight: slip?")
    return [f"{wheel.name}: {line}" for line in found]


def rolled_mostly_backwards(wheel: Wheel) -> bool:
    """Whether a wheel rolled backwards nearly all the way.

    That is rare but for a node that faces the other way.
    """
    return wheel.turned_angle >= _TURN and wheel.net_angle < -0.8 * wheel.turned_angle
