"""Rolling: without slip the wheel rolls at the speed of the ground under its contact.

    R (1 + e) p T = (v - r y) T

Contact speed of the model's README: p is the mean rate at which the wheel rolls, e the error of its radius,
v and r speed and yaw rate of the vehicle, y where the contact lies. Time stamps that are late by d show the
rate of d before: R (w_1 - w_0) d is added on the node whose clock the other's is compared with.
"""

from hubodo.fuse.wheel.entries import (
    CAMBER,
    EXCESS,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    SPEED,
    TIME_OFFSET,
    TRACK_WIDTH,
    WHEEL_RADIUS,
    YAW_RATE,
)
from hubodo.fuse.wheel.measurements.shared import Row, WheelWindow, WindowNoise
from hubodo.fuse.wheel.window import WINDOW, Window

STATES = (
    *(SPEED, YAW_RATE, TRACK_WIDTH, TIME_OFFSET),
    *(GYRO_SCALE_Z, GYRO_BIAS_Z, EXCESS, CAMBER, WHEEL_RADIUS),
)

_RESTING = 2e-5**2
"""m²; a wheel at rest creeps by less than 0.2 mm/s, estimated."""

_FLOOR = 1e-8
"""m²; 0.1 mm of a window's way that a tyre gives even where it hardly rolls, estimated."""


def usable(window: Window) -> bool:
    """Always: a clipped gyro is made good by EXCESS."""
    return True


def measure(w: WheelWindow, noise: WindowNoise) -> Row:
    """Residual in m. Variance: at rest, creeping; while driving, the road's unevenness along the way."""
    x, at, rate, r = w.x, w.at, w.rate, w.yaw_rate
    geometry = w.geometry
    size = geometry.radius * (1.0 + x[at[WHEEL_RADIUS]])
    contact = geometry.contact * (1.0 + x[at[TRACK_WIDTH]])
    # How a spin changes that is searched for is no measurement: it would pass for a clock that is late.
    late = geometry.clocked * geometry.radius * w.change if w.window.spin_clipped == 0.0 else 0.0
    return (
        (size * rate - x[at[SPEED]] + r * contact) * WINDOW + x[at[TIME_OFFSET]] * late,
        size * size * w.gyro_noise + (_RESTING if w.resting else noise.road * abs(rate) + _FLOOR),
        {
            SPEED: WINDOW,
            YAW_RATE: -(size * w.rate_by_yaw_rate + contact) * WINDOW,
            TRACK_WIDTH: -r * geometry.contact * WINDOW,
            TIME_OFFSET: -late,
            GYRO_SCALE_Z: -size * w.rate_by_scale * WINDOW,
            GYRO_BIAS_Z: -size * w.rate_by_bias * WINDOW,
            EXCESS: -size * WINDOW,
            CAMBER: -size * w.rate_by_camber * WINDOW,
            WHEEL_RADIUS: -geometry.radius * rate * WINDOW,
        },
    )
