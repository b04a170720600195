"""Terms of one window of a wheel that several measurements use, evaluated at the present states.

Complex numbers are x + iy of node axes; rotated by e^(iθ), θ the wheel angle, their real part points up and
their imaginary part forward (frames: README of the model). The node is transformed to face left.

    p = (∫ gz / T - b_z) / (1 + k) + u - lambda r sin(camber)        mean rolling rate
    θ_m = θ + p T / 2                                                wheel angle at the middle of the window

T is the length of the window, lambda +1 on the left wheel and -1 on the right one, r the yaw rate, k and b_z
scale error and bias of the gyro about the axle, u its rate beyond range, zero while it is not clipped. If it
was clipped all the time, p = ∫ gz / T + u - lambda r sin(camber): a limit has neither scale nor bias.

The residual of a measurement is measured minus expected. Its derivatives are those of expected minus
measured by the entries of the state, in the order of its STATES.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter

from hubodo.fuse.ranges import HIGH_G_CALIBRATION_SIGMA, HIGH_G_NOISE_DENSITY
from hubodo.fuse.wheel.axle_rate import correct_axle_rate
from hubodo.fuse.wheel.config import WheelNoise
from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    CAMBER,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    RATE_BEYOND_RANGE,
    WHEEL_ANGLE,
    YAW_RATE,
    Entry,
)
from hubodo.fuse.wheel.thresholds import STANDSTILL_FORCE_SIGMA
from hubodo.fuse.wheel.window import WINDOW_S, Window

Row = tuple[float, float, dict[Entry, float]]
"""Residual, its variance, and the derivatives of what is expected."""


@dataclass(frozen=True, slots=True)
class WheelGeometry:
    """Position of a wheel on the vehicle.

    Attributes
    ----------
    side : +1 left, -1 right.
    radius : m.
    contact_y : m, lateral position of the contact in the body.
    delay_factor : 1 if the entry TIME_OFFSET (s) is the delay of this node's time stamps, else 0.
    ground_rate : rad/s, rotation of the ground about the vertical with the Earth.
    """

    side: float
    radius: float
    contact_y: float
    delay_factor: float = 0.0
    ground_rate: float = 0.0


class WindowNoise:
    """Variances of the integrals of one window, from the densities of `WheelNoise`.

    Attributes
    ----------
    gyro, accel : rad² and (m/s)², white noise.
    beyond_range : (m/s)², noise and calibration error of an accelerometer that replaced a saturated one.
    roll_rate : rad², roll of the vehicle about its forward axis.
    axle_flex : rad² per (m/s²)² of vibration along the axle.
    forward_force, lateral_force : (m/s)², unmodelled specific force.
    vibration : (m/s)² per (m/s²)².
    road_roughness : m² s/rad, per rate of the wheel.
    """

    __slots__ = (
        "accel",
        "axle_flex",
        "beyond_range",
        "forward_force",
        "gyro",
        "lateral_force",
        "road_roughness",
        "roll_rate",
        "vibration",
    )

    def __init__(self, noise: WheelNoise, radius: float) -> None:
        t = WINDOW_S
        self.gyro, self.accel = noise.gyro**2 * t, noise.accel**2 * t
        self.beyond_range = HIGH_G_NOISE_DENSITY**2 * t + (HIGH_G_CALIBRATION_SIGMA * t) ** 2
        self.roll_rate, self.axle_flex = (noise.roll_rate * t) ** 2, (noise.axle_flex * t) ** 2
        self.forward_force, self.lateral_force = (
            (noise.forward_force * t) ** 2,
            (noise.lateral_force * t) ** 2,
        )
        self.vibration, self.road_roughness = (
            (noise.vibration_share * t) ** 2,
            noise.road_roughness**2 * radius * t,
        )


_STANDSTILL_VELOCITY_SIGMA = STANDSTILL_FORCE_SIGMA * WINDOW_S
STANDSTILL_FORCE_VARIANCE = _STANDSTILL_VELOCITY_SIGMA * _STANDSTILL_VELOCITY_SIGMA
"""(m/s)², of the specific force on a stationary wheel in a window."""

_LINEARISED_ENTRIES = (
    *(YAW_RATE, WHEEL_ANGLE, GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE, CAMBER),
    *(GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_X, MISALIGNMENT_Y),
    *(ACCEL_BIAS_X, ACCEL_BIAS_Y, LEVER_ARM_X, LEVER_ARM_Y),
)


class LinearisedWindow:
    """One window of one wheel evaluated at the present states; `linearise` refills it for each window.

    Attributes
    ----------
    window : the integrals.
    is_stationary : True if the vehicle stands still.
    gyro_noise : rad², noise of the angle of a window, as measured at the last standstill.
    force_noise : (m/s)², noise of the force of a window from engine vibration while the wheel hardly turns.
    x, columns : states, and the columns of this wheel's and the vehicle's entries.
    yaw_rate : rad/s.
    camber_sin, camber_cos : sine and cosine of the camber angle.
    axle_rate : rad/s, rate about the axle relative to the vehicle's axes.
    rolling_rate : rad/s, rate at which the wheel rolls; rate_by_...: its derivatives (by RATE_BEYOND_RANGE:
    1).
    rotation : e^(iθ_m); carrier, rate_carrier, lever: terms of the window times it.
    gyro_bias, tilt : rad/s, bias of gx + i gy; rad, share of the spin that leaks into it.
    across, force : rad and m/s, derotated, corrected for the node's errors.
    axle_rate_change : rad/s, change of the rate about the axle over the window.
    double_carrier : s, integral of e^(2iθ).
    yaw_change : rad/s, change of the yaw rate over the window; yaw_change_step: its change since the window
    before. Both are set by `update_yaw_change`, once for each window.
    """

    __slots__ = (
        *(
            "_pick",
            "across",
            "axle_rate",
            "axle_rate_change",
            "force_noise",
            "gyro_bias",
            "camber_cos",
            "camber_sin",
            "carrier",
            "columns",
        ),
        *("double_carrier", "force", "geometry", "gyro_noise", "is_stationary", "lever", "rate_by_bias"),
        *(
            "rate_by_camber",
            "rate_by_scale",
            "rate_by_yaw_rate",
            "rolling_rate",
            "rotation",
            "rate_carrier",
            "tilt",
            "window",
        ),
        *("x", "yaw_change", "yaw_change_step", "yaw_rate"),
    )

    def __init__(self, geometry: WheelGeometry, at: Mapping[Entry, int]) -> None:
        self.geometry, self.columns = geometry, at
        self.yaw_change = self.yaw_change_step = 0.0
        self._pick = itemgetter(*(at[entry] for entry in _LINEARISED_ENTRIES))

    def linearise(
        self,
        x: list[float],
        window: Window,
        is_stationary: bool,
        gyro_noise: float = 0.0,
        force_noise: float = 0.0,
    ) -> None:
        """Evaluate a window at the states x.

        gyro_noise, force_noise: (rad/s)² and (m/s²)², see `StandstillDetector`.
        """
        self.force_noise = force_noise * (WINDOW_S * WINDOW_S)
        self.gyro_noise = gyro_noise * (WINDOW_S * WINDOW_S)
        r, angle, scale_error, bias, beyond, camber, *errors = self._pick(x)
        bias_x, bias_y, tilt_x, tilt_y, force_x, force_y, arm_x, arm_y = errors
        self.x, self.window, self.is_stationary, self.yaw_rate = x, window, is_stationary, r
        self.camber_sin, self.camber_cos = sin, cos = math.sin(camber), math.cos(camber)
        side = self.geometry.side
        self.axle_rate, self.rate_by_scale, self.rate_by_bias = correct_axle_rate(
            window.spin / WINDOW_S, window.all_clipped, scale_error, bias, beyond
        )
        self.rolling_rate = self.axle_rate - side * r * sin
        self.rate_by_camber, self.rate_by_yaw_rate = -side * r * cos, -side * sin
        self.rotation = turn = cmath.exp(1j * (angle + self.rolling_rate * (0.5 * WINDOW_S)))
        spin = window.spin
        self.double_carrier = turn * turn * (WINDOW_S * math.sin(spin) / spin if spin else WINDOW_S)
        self.carrier, self.rate_carrier = carrier, rate_carrier = (
            window.carrier * turn,
            window.rate_carrier * turn,
        )
        self.lever = lever = window.lever * turn
        # A node rotated by the small vector m reads Ω - m x Ω: gx contains -m_y and gy m_x times the spin.
        self.gyro_bias, self.tilt = gyro_bias, tilt = complex(bias_x, bias_y), complex(-tilt_y, tilt_x)
        self.across = window.across * turn - gyro_bias * carrier - tilt * rate_carrier
        self.force = window.force * turn - complex(force_x, force_y) * carrier - complex(arm_x, arm_y) * lever
        self.axle_rate_change = window.rate_end - window.rate_start

    def update_yaw_change(self) -> None:
        """Measure the change of the yaw rate over the window from the rates across the axle at its edges."""
        window, bias, tilt = self.window, self.gyro_bias, self.tilt
        half = cmath.exp(0.5j * window.spin)
        own = (bias + tilt * window.rate_end) * half - (bias + tilt * window.rate_start) * half.conjugate()
        before, self.yaw_change = self.yaw_change, ((window.across_change - own) * self.rotation).real
        self.yaw_change_step = self.yaw_change - before
