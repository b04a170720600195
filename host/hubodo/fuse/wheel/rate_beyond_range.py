"""The spin that a clipped gyro does not show, as a state of the wheel filter: begun in each window anew."""

from __future__ import annotations

import cmath
import math

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    HEADING,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    RATE_BEYOND_RANGE,
    WHEEL_ANGLE,
    X,
    Y,
)
from hubodo.fuse.wheel.spin_search import rederotate_window
from hubodo.fuse.wheel.state import Wheel, reset_state
from hubodo.fuse.wheel.window import WINDOW_S, Window

_EXCESS_PUSH = 3.0
"""m/s² by which the spin beyond a clipped gyro may change from window to window: hard driving. Estimated."""

_EXCESS_SEEN = 0.15
"""m/s by which the way of a window may be off what gravity shows of the spin: braking that begins or ends in
it. Estimated."""

_LOST_ANGLE = 1.0
"""rad, 1 sigma of the wheel angle over a clipped window, from which on gravity's phase may be a turn off."""

_ARM = 0.004
"""m, 1 sigma, below which no lever arm gets known while gravity is looked for: what is believed of the arm is
taken away before that, and an arm that is off then passes for a spin that is. Found from 24 wheels whose
drives begin clipped: they are off by 1 to 6 mm, where the sums of their windows promise 0.6."""

_ASTRAY = 3
"""Windows in a row with gravity elsewhere; a hole in the road fills one. Estimated."""


def derotate_window(x: list[float], p: Array, wheel: Wheel, window: Window) -> tuple[Window, list[int]]:
    """The window turned by the spin that it is believed to have; x and p, in place, with that spin.

    The spin that a clipped gyro did not see is a state while it clips, and nothing else: in each window anew,
    about what gravity shows of it. Returns the states that were begun anew, too.
    """
    at, follower = wheel.columns, wheel.spin_tracker
    place, angle = at[RATE_BEYOND_RANGE], at[WHEEL_ANGLE]
    step = _EXCESS_PUSH * WINDOW_S / wheel.geometry.radius
    if not window.all_clipped:
        _unlearn_arm(p, wheel)
        if window.missing >= 1.0:
            # What is not heard begins where it is heard; what was followed until then has turned on unseen.
            if wheel.angle_initialised and follower.is_tracking:
                wheel.drop_angle()
            follower.pause()
        else:
            follower.record_unclipped(window)
        if window.spin_clipped == 0.0 and p[place, place] == 0.0:
            return window, []
        # Beyond the limit for less than a window it is not far beyond.
        x[place] = 0.0
        reset_state(p, place, (step * window.spin_clipped) ** 2)
        return rederotate_window(window, 0.0), [place]
    followed = follower.is_tracking
    if wheel.arm_variances is None:
        wheel.arm_variances = (
            p.item(at[LEVER_ARM_X], at[LEVER_ARM_X]),
            p.item(at[LEVER_ARM_Y], at[LEVER_ARM_Y]),
        )
    arm = complex(x[at[LEVER_ARM_X]], x[at[LEVER_ARM_Y]])
    follower.track_window(window, arm, complex(x[at[ACCEL_BIAS_X]], x[at[ACCEL_BIAS_Y]]))
    renewed = []
    if follower.is_observed:
        x[place] = follower.excess
        reset_state(p, place, (_EXCESS_SEEN / wheel.geometry.radius) ** 2)
        renewed.append(place)
    else:
        # Where gravity does not show it, the other measurements have; after a gap, what was found.
        known = p[place, place] > 0.0
        x[place] = x[place] + follower.slope * WINDOW_S if known else follower.excess
        p[place, place] += step * step
    far = p[angle, angle] + WINDOW_S * p[angle, place] + 0.25 * WINDOW_S**2 * p[place, place]
    # One that spins by itself changes by anything while nothing shows it; yaw and roll alone would hold an
    # angle half a turn off as firmly: the yaw rate is the other way then.
    blind = window.force_clipped > 0.0 and not follower.is_observed
    unseen = wheel.slip_detector.is_slipping and (blind or not followed)
    if wheel.angle_initialised and (unseen or far > _LOST_ANGLE**2):
        wheel.angle_losses += 1
        wheel.drop_angle()
    return rederotate_window(window, x[place], follower.slope), renewed


def _unlearn_arm(p: Array, wheel: Wheel) -> None:
    """The lever arm as unsure again, in place, as before gravity was looked for with it; at most _ARM."""
    if wheel.arm_variances is not None:
        for entry, known in zip((LEVER_ARM_X, LEVER_ARM_Y), wheel.arm_variances, strict=True):
            place = wheel.columns[entry]
            p[place, place] = max(p.item(place, place), min(known, _ARM**2))
        wheel.arm_variances = None


def reset_misaligned_angle(x: list[float], p: Array, wheel: Wheel, window: Window) -> list[int]:
    """Begins the wheel angle anew, in place, where gravity has long been elsewhere: half a turn off, or more.

    The way may be off by that turn. Returns the states that were begun anew.
    """
    at, change = wheel.columns, wheel.spin_tracker.slope * wheel.geometry.radius
    wheel.view.linearise(x, window, resting=False)
    off = cmath.phase(wheel.view.force / complex(STANDARD_GRAVITY, change))
    wheel.misaligned_windows = (
        wheel.misaligned_windows + 1 if wheel.spin_tracker.is_observed and abs(off) > _LOST_ANGLE else 0
    )
    if wheel.misaligned_windows < _ASTRAY:
        return []
    wheel.misaligned_windows, wheel.angle_losses = 0, wheel.angle_losses + 1
    x[at[WHEEL_ANGLE]] -= off
    reset_state(p, at[WHEEL_ANGLE], WHEEL_ANGLE.prior**2)
    course, turn = x[at[HEADING]], 2.0 * math.pi * wheel.geometry.radius
    way = np.array([turn * math.cos(course), turn * math.sin(course)])
    places = [at[X], at[Y]]
    p[np.ix_(places, places)] += np.outer(way, way)
    return [at[WHEEL_ANGLE]]
