"""Warnings for the user about a drive."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.fuse.wheel.window import WINDOW_S

START_WINDOWS = int(3.0 / WINDOW_S)
"""Windows at the start in which a standstill is expected; later it counts only if there was one at all."""
_FULL_TURN = 2.0 * math.pi


def list_warnings(wheel_filter: WheelFilter, motion_states: Array) -> list[str]:
    """Return one line for each warning; motion_states: (N,) of the poses."""
    lines = []
    start = motion_states[:START_WINDOWS]
    if not np.any(start != MotionState.MOVING):
        lines.append(
            "no rest at the start: gyro biases had to be found while driving; the heading is less sure for "
            "the first turns of the wheel. Stand still for five seconds before driving off"
        )
    elif not np.any(start == MotionState.STANDSTILL) and not np.any(motion_states == MotionState.STANDSTILL):
        lines.append("the vehicle was rocked at the start, never quite still: gyro biases are less sure")
    if wheel_filter.core.mounting_check.verdict:
        lines.append(f"{wheel_filter.core.mounting_check.verdict}; until then its speed is not used")
    lines += wheel_filter.core.outages.list_warnings(
        " and ".join(wheel.name for wheel in wheel_filter.core.wheels)
    )
    windows, outage_windows = wheel_filter.core.windows, wheel_filter.core.outages.windows
    for wheel in wheel_filter.core.wheels:
        lines += _wheel_warnings(wheel, windows, outage_windows, wheel_filter.refused[wheel.name])
    return lines


def _wheel_warnings(wheel: Wheel, windows: int, outage_windows: int, refused: int) -> list[str]:
    duration = windows * WINDOW_S
    if wheel.missing_windows >= windows:
        return [f"{wheel.name}: no samples; the track comes from the other wheel alone"]
    wheel_lines = []
    if wheel.missing_windows - outage_windows > 5:
        missing_time = wheel.missing_windows * WINDOW_S
        wheel_lines.append(f"not heard for {missing_time:.1f} s of {duration:.1f} s; sigmas grow there")
    if wheel.angle_losses:
        wheel_lines.append(
            f"the wheel angle was lost over a gap and reinitialised ({wheel.angle_losses} times): "
            "its clock jumped, or it turned on while it was not heard"
        )
    if refused:
        wheel_lines.append(
            f"{refused} samples left out because their time went back, or jumped ahead for one of them"
        )
    if wheel.turned_angle < _FULL_TURN:
        turns = wheel.turned_angle / _FULL_TURN
        wheel_lines.append(f"the wheel turned only {turns:.2f} times; scale, tilt and lever arm stay unknown")
    elif rolled_mostly_backwards(wheel):
        wheel_lines.append(
            "rolled backwards nearly all the way; if the vehicle drove forwards, the node faces the other "
            "way: change its facing"
        )
    if wheel.upright_count >= 50 and wheel.upright_sum < 0.5 * wheel.upright_count:
        wheel_lines.append(
            "gravity does not turn with gz; an axis is mirrored, or the node is not on the wheel"
        )
    if wheel.clipped_windows:
        clipped_time = wheel.clipped_windows * WINDOW_S
        wheel_lines.append(
            f"gz at its limit for {clipped_time:.1f} s; spin there is from gravity and centripetal force"
        )
    if wheel.outlier_windows > max(5, 0.05 * windows):
        outlier_time = wheel.outlier_windows * WINDOW_S
        wheel_lines.append(f"disagreed with the other wheel for {outlier_time:.1f} s and lost weight: slip?")
    return [f"{wheel.name}: {line}" for line in wheel_lines]


def rolled_mostly_backwards(wheel: Wheel) -> bool:
    """Return True if a wheel rolled backwards nearly all the way, as with a wrong facing."""
    return wheel.turned_angle >= _FULL_TURN and wheel.net_angle < -0.8 * wheel.turned_angle
