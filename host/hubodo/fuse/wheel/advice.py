"""What a user must know of a drive that the wheel filter went through."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.window import WINDOW

BEGINNING = int(3.0 / WINDOW)
"""Windows in which a drive is expected to rest; behind them it counts only whether it ever did."""
_TURN = 2.0 * math.pi


def warnings_of(made: WheelFilter, still: Array) -> list[str]:
    """What a user must know of a drive so far; still: (N,) of the poses."""
    lines = []
    beginning = still[:BEGINNING]
    if not np.any(beginning != Stillness.MOVING):
        lines.append(
            "no rest at the start: gyro biases had to be found while driving; the heading is less sure for "
            "the first turns of the wheel. Stand still for five seconds before driving off"
        )
    elif not np.any(beginning == Stillness.RESTING) and not np.any(still == Stillness.RESTING):
        lines.append("the vehicle was rocked at the start, never quite still: gyro biases are less sure")
    if made.core.agreement.verdict:
        lines.append(f"{made.core.agreement.verdict}; until then its speed is not used")
    lines += made.core.silences.lines(" and ".join(wheel.name for wheel in made.core.wheels))
    windows, silent = made.core.windows, made.core.silences.windows
    for wheel in made.core.wheels:
        lines += _wheel_warnings(wheel, windows, silent, made.refused[wheel.name])
    return lines


def _wheel_warnings(wheel: Wheel, windows: int, silent: int, refused: int) -> list[str]:
    whole = windows * WINDOW
    if wheel.unheard_in_all >= windows:
        return [f"{wheel.name}: no samples; the track comes from the other wheel alone"]
    found = []
    if wheel.unheard_in_all - silent > 5:
        gone = wheel.unheard_in_all * WINDOW
        found.append(f"not heard for {gone:.1f} s of {whole:.1f} s; sigmas grow there")
    if wheel.lost:
        found.append(
            f"the wheel angle was lost over a gap and found anew ({wheel.lost} times): "
            "its clock jumped, or it turned on while it was not heard"
        )
    if refused:
        found.append(
            f"{refused} samples left out because their time went back, or jumped ahead for one of them"
        )
    if wheel.turned < _TURN:
        turns = wheel.turned / _TURN
        found.append(f"the wheel turned only {turns:.2f} times; scale, tilt and lever arm stay unknown")
    elif backwards(wheel):
        found.append(
            "rolled backwards nearly all the way; if the vehicle drove forwards, the node faces the other "
            "way: change its facing"
        )
    if wheel.moving >= 50 and wheel.upright < 0.5 * wheel.moving:
        found.append("gravity does not turn with gz; an axis is mirrored, or the node is not on the wheel")
    if wheel.clipped:
        limit = wheel.clipped * WINDOW
        found.append(f"gz at its limit for {limit:.1f} s; spin there is from gravity and centripetal force")
    if wheel.slips > max(5, 0.05 * windows):
        lost = wheel.slips * WINDOW
        found.append(f"disagreed with the other wheel for {lost:.1f} s and lost weight: slip?")
    return [f"{wheel.name}: {line}" for line in found]


def backwards(wheel: Wheel) -> bool:
    """Whether a wheel rolled backwards nearly all the way.

    That is rare but for a node that faces the other way.
    """
    return wheel.turned >= _TURN and wheel.forwards < -0.8 * wheel.turned
