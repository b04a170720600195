"""What several measurements take from one window of a wheel, worked out once under the present states.

Complex numbers are x + iy of node axes; turned by e^(i theta), theta the wheel angle, their real part points
up and their imaginary part forward (frames: the model's README). The node is taken to face left.

    p = (int gz / T - b_z) / (1 + k) + u - lambda r sin(camber)        the mean rate at which the wheel rolls
    theta_m = theta + p T / 2                                          its angle at the middle of the window

T is the window, lambda +1 on the left wheel and -1 on the right one, r the yaw rate, k and b_z scale and bias
of the gyro about the axle, u what it did not see because it was clipped, zero otherwise. Where it was clipped
all the time p = int gz / T + u - lambda r sin(camber): a limit has neither scale nor bias.

A measurement's residual is measured minus expected; its derivatives are those of what is expected less what
is measured, by the entries of the state, in the order of its STATES.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter

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
from hubodo.fuse.wheel.window import WINDOW_S, Window

Row = tuple[float, float, dict[Entry, float]]
"""Residual, its variance, and the derivatives of what is expected."""


@dataclass(frozen=True, slots=True)
class WheelGeometry:
    """How a wheel stands on the vehicle.

    side: +1 left, -1 right. radius: m. contact: y of the contact in the body, m. clocked: +1 where the entry
    TIME_OFFSET, in s, is the lateness of this node's time stamps, else 0. ground_rate: rad/s by which the
    ground turns about up with the Earth.
    """

    side: float
    radius: float
    contact_y: float
    delay_factor: float = 0.0
    ground_rate: float = 0.0


class WindowNoise:
    """Variances of what a window's integrals hold by chance, from the densities and sizes of `WheelNoise`.

    gyro: (rad)², accel: (m/s)², white noise summed up over the window. roll: (rad)², the vehicle rolling
    about its forward axis. flex: (rad)² per (m/s²)² of vibration along the axle. push: (m/s)², forward force
    that the wheel does not show. sway: (m/s)², sideways. vibration: (m/s)² per (m/s²)² of it. road: m²
    s/rad, unevenness per rate of the wheel.
    """

    __slots__ = (
        "accel",
        "axle_flex",
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
        self.roll_rate, self.axle_flex = (noise.roll_rate * t) ** 2, (noise.axle_flex * t) ** 2
        self.forward_force, self.lateral_force = (
            (noise.forward_force * t) ** 2,
            (noise.lateral_force * t) ** 2,
        )
        self.vibration, self.road_roughness = (
            (noise.vibration_share * t) ** 2,
            noise.road_roughness**2 * radius * t,
        )


STANDSTILL_FORCE_VARIANCE = (0.02 * WINDOW_S) ** 2
"""(m/s)²; force that a wheel at rest still feels, 0.02 m/s² 1 sigma: somebody sits, the ground gives.
Estimated."""

_HARDLY = 1e-6
"""rad; a wheel that turns by less turns nothing within a window."""

_SEEN = (
    *(YAW_RATE, WHEEL_ANGLE, GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE, CAMBER),
    *(GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_X, MISALIGNMENT_Y),
    *(ACCEL_BIAS_X, ACCEL_BIAS_Y, LEVER_ARM_X, LEVER_ARM_Y),
)


class LinearisedWindow:
    """One window of one wheel under the present states; `look` fills it anew for each window.

    window: the integrals; resting: whether the vehicle stands still; gyro_noise: (rad)², what the
    last rest showed to be random in an angle of a window. x: states of the filter; at: the column
    of each entry of this wheel and the vehicle. yaw_rate: rad/s. sin, cos: of the camber. about_axle: rad/s
    that the gyro about the axle feels; rate: rad/s at which the wheel rolls, and its derivatives by scale
    and bias of that gyro, camber and yaw rate (by EXCESS it is 1). Turned by e^(i theta_m): turn itself;
    carrier, swing, lever of the window; across, rad, and force, m/s, with the node's errors taken out.
    change: rad/s by which the gyro about the axle changes over the window. twice: s, the integral of one that
    turns twice as fast. yaw_change: rad/s by which the yaw rate changes over the window, yaw_bend: rad/s by
    which it changes more than over the window before; numbers that are set once, by `see_change`.
    """

    __slots__ = (
        *(
            "_pick",
            "across",
            "axle_rate",
            "axle_rate_change",
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
            "swing",
            "window",
        ),
        *("x", "yaw_change", "yaw_change_step", "yaw_rate"),
    )

    def __init__(self, geometry: WheelGeometry, at: Mapping[Entry, int]) -> None:
        self.geometry, self.columns = geometry, at
        self.yaw_change = self.yaw_change_step = 0.0
        self._pick = itemgetter(*(at[entry] for entry in _SEEN))

    def linearise(self, x: list[float], window: Window, resting: bool, gyro_noise: float = 0.0) -> None:
        """Everything above for the states x and a window. gyro_noise: (rad/s)², see RestDetector."""
        self.gyro_noise = gyro_noise * (WINDOW_S * WINDOW_S)
        r, angle, k, b, excess, camber, *errors = self._pick(x)
        bias_x, bias_y, tilt_x, tilt_y, force_x, force_y, arm_x, arm_y = errors
        self.x, self.window, self.is_stationary, self.yaw_rate = x, window, resting, r
        self.camber_sin, self.camber_cos = sin, cos = math.sin(camber), math.cos(camber)
        side, stretch = self.geometry.side, 1.0 + k
        if window.all_clipped:
            seen, self.rate_by_scale, self.rate_by_bias = window.spin / WINDOW_S, 0.0, 0.0
        else:
            seen = (window.spin / WINDOW_S - b) / stretch
            self.rate_by_scale, self.rate_by_bias = -seen / stretch, -1.0 / stretch
        self.axle_rate = seen + excess
        self.rolling_rate = self.axle_rate - side * r * sin
        self.rate_by_camber, self.rate_by_yaw_rate = -side * r * cos, -side * sin
        self.rotation = turn = cmath.exp(1j * (angle + self.rolling_rate * (0.5 * WINDOW_S)))
        spin = window.spin
        self.double_carrier = (
            turn * turn * (WINDOW_S if abs(spin) < _HARDLY else WINDOW_S * math.sin(spin) / spin)
        )
        self.carrier, self.swing = carrier, swing = window.carrier * turn, window.swing * turn
        self.lever = lever = window.lever * turn
        # A node turned by the small vector m reads Omega - m x Omega: gx gains -m_y, gy gains m_x of the
        # spin.
        self.across = (
            window.across * turn - complex(bias_x, bias_y) * carrier - complex(-tilt_y, tilt_x) * swing
        )
        self.force = window.force * turn - complex(force_x, force_y) * carrier - complex(arm_x, arm_y) * lever
        self.axle_rate_change = window.rate_end - window.rate_start

    def update_yaw_change(self) -> None:
        """How the yaw rate changes over the window: what the gyros across the axle show at its edges."""
        x, at, window = self.x, self.columns, self.window
        half = cmath.exp(0.5j * window.spin)
        tilt = complex(-x[at[MISALIGNMENT_Y]], x[at[MISALIGNMENT_X]])
        bias = complex(x[at[GYRO_BIAS_X]], x[at[GYRO_BIAS_Y]])
        own = (bias + tilt * window.rate_end) * half - (bias + tilt * window.rate_start) * half.conjugate()
        before, self.yaw_change = self.yaw_change, ((window.across_change - own) * self.rotation).real
        self.yaw_change_step = self.yaw_change - before
