"""State of the rate beyond the range of a saturated gyro about the axle, reset in each window."""

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
from hubodo.fuse.wheel.gravity_alignment import MAX_ANGLE_ERROR
from hubodo.fuse.wheel.measurements.steady import GRAVITY_SPEED_SIGMA, ONE_AXIS_SPEED_SIGMA
from hubodo.fuse.wheel.spin_search import MAX_RATE_BEYOND, rederotate_window
from hubodo.fuse.wheel.thresholds import BUMP_WINDOWS, HARD_ACCELERATION, MIN_ARM_LENGTH, SETTLING_WINDOWS
from hubodo.fuse.wheel.wheel import Wheel, reset_state
from hubodo.fuse.wheel.window import WINDOW_S, Window

_MAX_BLIND_VARIANCE = MAX_RATE_BEYOND**2 / 12.0
"""(rad/s)², of a uniform distribution over the rates that are searched."""

_MAX_BLIND_WINDOWS = SETTLING_WINDOWS
"""Consecutive windows without gravity in any axis after which the wheel angle is unknown: at 3 m/s² of
braking the angle of a wheel of 0.3 m is then off by 1.3 rad."""


def derotate_window(x: list[float], p: Array, wheel: Wheel, window: Window) -> tuple[Window, list[int]]:
    """Return the window derotated by its estimated spin, and the columns that were reset.

    The rate beyond range is a state only while the gyro clips. In each window it is reset, in place, to the
    rate at which gravity rotates.
    """
    columns, tracker = wheel.columns, wheel.spin_tracker
    beyond, angle = columns[RATE_BEYOND_RANGE], columns[WHEEL_ANGLE]
    step = HARD_ACCELERATION * WINDOW_S / wheel.geometry.radius
    if not window.all_clipped:
        _restore_arm_variance(p, wheel)
        _track_unclipped(wheel, window)
        if window.spin_clipped == 0.0 and p[beyond, beyond] == 0.0:
            return window, []
        # A gyro that clips for less than a window is not far beyond its range.
        x[beyond] = 0.0
        reset_state(p, beyond, (step * window.spin_clipped) ** 2)
        return rederotate_window(window, 0.0), [beyond]
    was_tracking = tracker.is_tracking
    if wheel.arm_variances is None:
        arm_x, arm_y = columns[LEVER_ARM_X], columns[LEVER_ARM_Y]
        wheel.arm_variances = p.item(arm_x, arm_x), p.item(arm_y, arm_y)
    arm = complex(x[columns[LEVER_ARM_X]], x[columns[LEVER_ARM_Y]])
    tracker.track_window(window, arm, complex(x[columns[ACCEL_BIAS_X]], x[columns[ACCEL_BIAS_Y]]))
    reset_columns = []
    if tracker.is_observed:
        x[beyond] = tracker.excess
        speed_sigma = GRAVITY_SPEED_SIGMA if tracker.gravity_angle is None else ONE_AXIS_SPEED_SIGMA
        reset_state(p, beyond, (speed_sigma / wheel.geometry.radius) ** 2)
        reset_columns.append(beyond)
    else:
        # Without gravity the other measurements have estimated it; after a gap, the last search.
        is_estimated = p[beyond, beyond] > 0.0
        x[beyond] = x[beyond] + tracker.slope * WINDOW_S if is_estimated else tracker.excess
        p[beyond, beyond] += step * step
        if window.force_clipped > 0.0:
            _widen_blind_rate(p, wheel, step)
    angle_variance = p[angle, angle] + WINDOW_S * p[angle, beyond] + 0.25 * WINDOW_S**2 * p[beyond, beyond]
    # The rate is arbitrary while nothing measures it, and yaw and roll alone would hold a wrong rate, or an
    # angle half a turn off, as firmly, with the opposite yaw rate.
    is_blind = window.force_clipped > 0.0 and not tracker.is_observed
    is_unobserved = wheel.slip_detector.is_slipping and (is_blind or not was_tracking)
    is_unobserved |= is_blind and tracker.unobserved_windows > _MAX_BLIND_WINDOWS
    if wheel.angle_initialised and (is_unobserved or angle_variance > MAX_ANGLE_ERROR**2):
        wheel.counts.angle_losses += 1
        wheel.drop_angle()
    window = window._replace(
        gravity_angle=tracker.gravity_angle, blind_windows=tracker.unobserved_windows if is_blind else 0
    )
    return rederotate_window(window, x[beyond], tracker.slope), reset_columns


def _widen_blind_rate(p: Array, wheel: Wheel, step: float) -> None:
    """Add variance, in place, to a rate that nothing measures; step: rad/s, its change in a window.

    Braking lasts for seconds, so the changes of all windows add up: after k windows the variance grows by (k
        + 1)² - k² = 2 k + 1 squared steps.
    """
    beyond = wheel.columns[RATE_BEYOND_RANGE]
    growth = 2.0 * step * step * wheel.spin_tracker.unobserved_windows
    p[beyond, beyond] += min(growth, max(0.0, _MAX_BLIND_VARIANCE - p.item(beyond, beyond)))


def _track_unclipped(wheel: Wheel, window: Window) -> None:
    """Update the tracker with a window whose gyro is not clipped all the time."""
    tracker = wheel.spin_tracker
    if window.missing >= 1.0:
        # A wheel with a clipped gyro has turned by an unknown angle in a gap.
        if wheel.angle_initialised and tracker.is_tracking:
            wheel.drop_angle()
        tracker.pause()
    else:
        tracker.record_unclipped(window)


def _restore_arm_variance(p: Array, wheel: Wheel) -> None:
    """Restore, in place, the lever arm's variance from before the search, if not above `MIN_ARM_LENGTH`²."""
    if wheel.arm_variances is not None:
        for entry, variance in zip((LEVER_ARM_X, LEVER_ARM_Y), wheel.arm_variances, strict=True):
            column = wheel.columns[entry]
            p[column, column] = max(p.item(column, column), min(variance, MIN_ARM_LENGTH**2))
        wheel.arm_variances = None


def reset_misaligned_angle(x: list[float], p: Array, wheel: Wheel, window: Window) -> list[int]:
    """Reset the wheel angle in place if gravity contradicts it for some windows; return the reset columns.

    The position may be off by one turn of the wheel.
    """
    columns, change = wheel.columns, wheel.spin_tracker.slope * wheel.geometry.radius
    wheel.view.linearise(x, window, is_stationary=False)
    if window.gravity_angle is None:
        phase = cmath.phase(wheel.view.force / complex(STANDARD_GRAVITY, change))
    else:
        phase = cmath.phase(wheel.view.rotation * cmath.exp(-1j * window.gravity_angle))
    is_misaligned = wheel.spin_tracker.is_observed and abs(phase) > MAX_ANGLE_ERROR
    wheel.misaligned_windows = wheel.misaligned_windows + 1 if is_misaligned else 0
    if wheel.misaligned_windows < BUMP_WINDOWS:
        return []
    wheel.misaligned_windows, wheel.counts.angle_losses = 0, wheel.counts.angle_losses + 1
    x[columns[WHEEL_ANGLE]] -= phase
    reset_state(p, columns[WHEEL_ANGLE], WHEEL_ANGLE.prior**2)
    course, turn = x[columns[HEADING]], 2.0 * math.pi * wheel.geometry.radius
    displacement = np.array([turn * math.cos(course), turn * math.sin(course)])
    position = [columns[X], columns[Y]]
    p[np.ix_(position, position)] += np.outer(displacement, displacement)
    return [columns[WHEEL_ANGLE]]
