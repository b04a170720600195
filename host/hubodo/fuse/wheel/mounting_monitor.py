"""Test of each window of two wheels whether they form the declared axle, and what follows for the filter."""

from __future__ import annotations

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import (
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    X,
    Y,
)
from hubodo.fuse.wheel.measurement_update import UpdateResult
from hubodo.fuse.wheel.mounting_check import AXLE_YAW_RMS, BOTH_WHEELS, MountingCheck
from hubodo.fuse.wheel.records import WheelWindows
from hubodo.fuse.wheel.wheel import Wheel, WheelMode
from hubodo.fuse.wheel.window_processor import WindowProcessor


def check_mounting(
    core: WindowProcessor, check: MountingCheck, windows: WheelWindows, result: UpdateResult
) -> None:
    """Add a window of two undisturbed wheels to the check; once it is decided, restrict the wheels."""
    if (
        len(windows) < 2
        or not check.is_undecided
        or any(
            not wheel.angle_initialised
            or wheel.is_slipping
            or window.missing > 0.0
            or window.spin_clipped + window.across_clipped > 0.0
            for wheel, window in windows
        )
    ):
        return
    # The yaw rates of the window were computed with the states at its start.
    p = core.history.newest.start_p
    for rate, (wheel, _) in zip(result.rolling_rates, windows, strict=True):
        if _across_rate_variance(p, wheel, rate) > AXLE_YAW_RMS**2:
            return
    speeds = [
        rate * wheel.geometry.radius for rate, wheel in zip(result.rolling_rates, core.wheels, strict=True)
    ]
    left, right = (0, 1) if core.wheels[0].geometry.side > 0 else (1, 0)
    yaw_rates = result.yaw_rates[left], result.yaw_rates[right]
    distrusted = check.add(yaw_rates, speeds[left], speeds[right])
    if distrusted is not None:
        _apply_verdict(core, check, distrusted)


def _across_rate_variance(p: Array, wheel: Wheel, rate: float) -> float:
    """Return the variance of the rates across the axle, (rad/s)², the mean of both, from bias and tilt.

    A drive that begins in motion knows neither in its first windows: tilts of a degree leak 0.3 rad/s of the
    spin of a car's wheel, with which two wheels of one axle seem to steer. rate: rad/s, of the wheel.
    """
    columns, item = wheel.columns, p.item
    x, y, tilt_x, tilt_y = (
        columns[entry] for entry in (GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_X, MISALIGNMENT_Y)
    )
    leaked = item(tilt_x, tilt_x) + item(tilt_y, tilt_y)
    correlated = item(y, tilt_x) - item(x, tilt_y)
    return 0.5 * float(item(x, x) + item(y, y) + 2.0 * rate * correlated + rate * rate * leaked)


def _apply_verdict(core: WindowProcessor, check: MountingCheck, distrusted: float) -> None:
    """Restrict the wheels by the verdict of the mounting check.

    distrusted: side of the wheel, +1 or -1, or BOTH_WHEELS. Its errors may already be in the position,
    whose covariance is inflated.
    """
    distance = 2.0 * max(abs(distance) for distance in check.wheel_distances)
    core.inflate({X: distance * distance, Y: distance * distance})
    for wheel in core.wheels:
        is_usable = check.usable_side in (0.0, wheel.geometry.side)
        if not is_usable:
            wheel.best_mode = WheelMode.DISABLED
        elif check.sides_swapped:
            wheel.swap_side()
        elif not check.other_wheel_steers and distrusted in (BOTH_WHEELS, wheel.geometry.side):
            wheel.best_mode = WheelMode.DISTRUSTED_SPEED
