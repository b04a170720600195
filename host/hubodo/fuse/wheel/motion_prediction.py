"""Prediction of speed and yaw rate for the middle of a window, before its measurements."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.axle_rate import mean_axle_rate
from hubodo.fuse.wheel.entries import (
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    SLOPE,
    SPEED,
    WHEEL_ANGLE,
    YAW_RATE,
    StateLayout,
)
from hubodo.fuse.wheel.free_motion import (
    free_motion_variances,
    vehicle_motion_sigmas,
)
from hubodo.fuse.wheel.measurements import WindowNoise, forward, zero_velocity
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.records import WheelWindows
from hubodo.fuse.wheel.thresholds import HARD_ACCELERATION, MANOEUVRE_WINDOWS, MAX_MISSING_SHARE
from hubodo.fuse.wheel.wheel import reset_state
from hubodo.fuse.wheel.window import WINDOW_S

_RATE_STEP_SIGMA = 0.5
"""m/s and rad/s, process noise of measured speed and yaw rate per window, so large that the measurements
decide. Unmeasured ones follow `free_motion.py`. Estimated."""

_FORGOTTEN_YAW_WINDOWS = MANOEUVRE_WINDOWS
"""Windows after which an unmeasured yaw rate starts again from zero: a vehicle does not drive in circles as
long as its only wheel is beyond its range, and covariances about a circle are too thin along it."""

_MAX_VEHICLE_ACCELERATION = 5.0
"""m/s², half of gravity: the limit of a good tyre on a dry road."""


def detect_wheel_motion(windows: WheelWindows, x: list[float], p: Array) -> list[MotionState]:
    """Return the motion state of each wheel; x and p are states and covariance, for the gyro biases."""
    states = []
    for wheel, window in windows:
        columns = wheel.columns
        spin, bx, by = columns[GYRO_BIAS_Z], columns[GYRO_BIAS_X], columns[GYRO_BIAS_Y]
        sigma = math.sqrt(max(p.item(spin, spin), p.item(bx, bx), p.item(by, by)))
        states.append(wheel.standstill.detect(window, x[spin], complex(x[bx], x[by]), sigma))
    return states


def vehicle_motion(wheel_states: Sequence[MotionState], is_slipping: Sequence[bool]) -> MotionState:
    """Return the motion state of the vehicle, that of its least stationary wheel.

    Slipping wheels do not count; if all slip, the vehicle is assumed to move.
    """
    states = (state for state, slips in zip(wheel_states, is_slipping, strict=True) if not slips)
    return min(states, default=MotionState.MOVING)


class _SpeedChange(NamedTuple):
    """Speed change over a window from accelerometers, m/s; its variance; its derivatives (n,)."""

    change: float
    variance: float
    derivatives: Array


class MotionPrediction:
    """Prediction of states and covariance for a window, both in place.

    Attributes
    ----------
    reset_states : columns that the last prediction reset.
    speed_row : derivatives (n,) of the speed by the previous states if the accelerometers propagated it.
    """

    def __init__(self, columns: StateLayout, noise: WindowNoise) -> None:
        self._columns, self._noise = columns.vehicle, noise
        self._last_change: _SpeedChange | None = None
        self.reset_states: list[int] = []
        self.speed_row: Array | None = None

    def predict(
        self,
        x: list[float],
        p: Array,
        windows: WheelWindows,
        motion_state: MotionState,
        is_inertial: bool,
        has_surface_speeds: bool,
        max_speed: float,
    ) -> None:
        """Predict speed and yaw rate.

        is_inertial: the speed is propagated by accelerometers alone. has_surface_speeds: another odometer
        measures this window. max_speed: m/s reached so far.
        """
        self.reset_states, self.speed_row = [], None
        if is_inertial:
            self._integrate_force(x, p, windows, max_speed)
        elif motion_state is MotionState.MOVING:
            self._free_rates(x, p, windows, has_surface_speeds, max_speed)
        else:
            self._stand(x, p, motion_state)

    def clear_force(self) -> None:
        """Forget the force of the previous window, because another window comes next."""
        self._last_change = None

    def _free_rates(
        self, x: list[float], p: Array, windows: WheelWindows, has_surface_speeds: bool, max_speed: float
    ) -> None:
        """Propagate the speed by the mean forward force; the rest is process noise."""
        speed, yaw_rate = self._columns[SPEED], self._columns[YAW_RATE]
        force = _forward_force(windows, x)
        self._last_change = None
        if force is not None:
            force -= x[self._columns[SLOPE]]
            x[speed] += min(_MAX_VEHICLE_ACCELERATION, max(-_MAX_VEHICLE_ACCELERATION, force)) * WINDOW_S
        received = [wheel for wheel, window in windows if window.missing < MAX_MISSING_SHARE]
        measures_yaw = (
            has_surface_speeds or len(received) == 2 or any(wheel.angle_initialised for wheel in received)
        )
        speed_variance, yaw_variance = _RATE_STEP_SIGMA**2, _RATE_STEP_SIGMA**2
        if not measures_yaw:
            free_speed_variance, yaw_variance = free_motion_variances(vehicle_motion_sigmas(max_speed))
            speed_variance = speed_variance if received or has_surface_speeds else free_speed_variance
        blind = min([window.blind_windows for _, window in windows], default=0)
        if (
            blind > 0
            and not has_surface_speeds
            and p.item(speed, speed) < vehicle_motion_sigmas(max_speed).speed ** 2
        ):
            # Braking lasts for seconds, so the changes of k windows add up: the variance grows by k² - (k -
            # 1)² squared changes.
            speed_variance += 2.0 * blind * (HARD_ACCELERATION * WINDOW_S) ** 2
        p[speed, speed] += speed_variance
        p[yaw_rate, yaw_rate] += yaw_variance
        if blind == _FORGOTTEN_YAW_WINDOWS and not measures_yaw:
            x[yaw_rate] = 0.0
            reset_state(p, yaw_rate, vehicle_motion_sigmas(max_speed).yaw_rate ** 2)
            self.reset_states.append(yaw_rate)

    def _integrate_force(self, x: list[float], p: Array, windows: WheelWindows, max_speed: float) -> None:
        """Propagate the speed by the forward force, with its dependence on slope, wheel angle and biases.

        Speeds are means over a window, so half of the change belongs to the previous window.
        """
        speed, yaw_rate = self._columns[SPEED], self._columns[YAW_RATE]
        now = self._speed_change(x, windows)
        before, self._last_change = self._last_change or now, now
        if now is None or before is None:
            p[speed, speed] += _RATE_STEP_SIGMA**2
        else:
            limit = _MAX_VEHICLE_ACCELERATION * WINDOW_S
            x[speed] += min(limit, max(-limit, 0.5 * (before.change + now.change)))
            derivatives = 0.5 * (before.derivatives + now.derivatives)
            derivatives[speed] += 1.0
            row = derivatives.dot(p)
            p[speed, :] = row
            p[:, speed] = row
            p[speed, speed] = row.dot(derivatives) + 0.5 * (before.variance + now.variance)
            self.speed_row = derivatives
        # Without any known wheel angle the yaw rate is not measured.
        measures_yaw = any(
            wheel.angle_initialised and window.missing < MAX_MISSING_SHARE for wheel, window in windows
        )
        p[yaw_rate, yaw_rate] += (
            _RATE_STEP_SIGMA**2
            if measures_yaw
            else free_motion_variances(vehicle_motion_sigmas(max_speed))[1]
        )

    def _speed_change(self, x: list[float], windows: WheelWindows) -> _SpeedChange | None:
        """Return the mean speed change from usable accelerometers; None if there is none."""
        change, variance, derivatives, count = 0.0, 0.0, np.zeros(len(x)), 0
        for wheel, window in windows:
            if not wheel.mode(window).knows_angle or window.missing > 0.0 or not forward.is_usable(window):
                continue
            wheel.view.linearise(
                x,
                window,
                is_stationary=False,
                gyro_noise=wheel.standstill.noise,
                force_noise=wheel.standstill.force_noise_of(window),
            )
            residual, noise, by_entry = forward.measure(wheel.view, self._noise)
            change += residual + wheel.geometry.radius * wheel.view.axle_rate_change
            variance += noise
            for entry, value in by_entry.items():
                derivatives[wheel.columns[entry]] -= value
            count += 1
        return _SpeedChange(change / count, variance / count**2, derivatives / count) if count else None

    def _stand(self, x: list[float], p: Array, motion_state: MotionState) -> None:
        """Reset speed and yaw rate of a stationary vehicle in each window.

        The measurements of the window then replace the previous estimate.
        """
        self._last_change = None
        for residual, variance, derivatives in zero_velocity.measure(x, self._columns, motion_state):
            for entry in derivatives:
                column = self._columns[entry]
                x[column] += residual
                reset_state(p, column, variance)
                self.reset_states.append(column)


def _forward_force(windows: WheelWindows, x: list[float]) -> float | None:
    """Return the mean forward specific force, m/s², over usable accelerometers; None if there is none."""
    total, count = 0.0, 0
    for wheel, window in windows:
        if wheel.mode(window).knows_angle and window.missing == 0.0 and window.force_clipped == 0.0:
            rate = mean_axle_rate(x, wheel.columns, window).rate
            angle = x[wheel.columns[WHEEL_ANGLE]] + 0.5 * rate * WINDOW_S
            total += (window.force * cmath.exp(1j * angle)).imag / WINDOW_S
            count += 1
    return total / count if count else None
