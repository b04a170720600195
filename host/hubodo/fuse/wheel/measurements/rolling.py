"""Rolling: without slip the wheel rolls at the speed of the ground under its contact.

    R (1 + e) p T = (v - r y) T

Contact speed of the model's README: p is the mean rate at which the wheel rolls, e the error of its radius,
v and r speed and yaw rate of the vehicle, y where the contact lies. Time stamps that are late by d show the
rate of d before: R (w_1 - w_0) d is added on the node whose clock the other's is compared with.
"""

from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    RATE_BEYOND_RANGE,
    SPEED,
    TIME_OFFSET,
    TRACK_WIDTH,
    WHEEL_RADIUS,
    YAW_RATE,
)
from hubodo.fuse.wheel.measurements.shared import LinearisedWindow, Row, WindowNoise
from hubodo.fuse.wheel.window import WINDOW_S, Window

STATES = (
    *(SPEED, YAW_RATE, TRACK_WIDTH, TIME_OFFSET),
    *(GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE, CAMBER, WHEEL_RADIUS),
)

_RESTING = 2e-5**2
"""m²; a wheel at rest creeps by less than 0.2 mm/s, estimated."""

_FLOOR = 1e-8
"""m²; 0.1 mm of a window's way that a tyre gives even where it hardly rolls, estimated."""


def usable(window: Window) -> bool:
    """Always: a clipped gyro is made good by EXCESS."""
    return True


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Residual in m. Variance: at rest, creeping; while driving, the road's unevenness along the way."""
    x, at, rate, r = w.x, w.columns, w.rolling_rate, w.yaw_rate
    geometry = w.geometry
    size = geometry.radius * (1.0 + x[at[WHEEL_RADIUS]])
    contact = geometry.contact_y * (1.0 + x[at[TRACK_WIDTH]])
    # How a spin changes that is searched for is no measurement: it would pass for a clock that is late.
    late = (
        geometry.delay_factor * geometry.radius * w.axle_rate_change if w.window.spin_clipped == 0.0 else 0.0
    )
    return (
        (size * rate - x[at[SPEED]] + r * contact) * WINDOW_S + x[at[TIME_OFFSET]] * late,
        size * size * w.gyro_noise
        + (_RESTING if w.is_stationary else noise.road_roughness * abs(rate) + _FLOOR),
        {
            SPEED: WINDOW_S,
            YAW_RATE: -(size * w.rate_by_yaw_rate + contact) * WINDOW_S,
            TRACK_WIDTH: -r * geometry.contact_y * WINDOW_S,
            TIME_OFFSET: -late,
            GYRO_SCALE_Z: -size * w.rate_by_scale * WINDOW_S,
            GYRO_BIAS_Z: -size * w.rate_by_bias * WINDOW_S,
            RATE_BEYOND_RANGE: -size * WINDOW_S,
            CAMBER: -size * w.rate_by_camber * WINDOW_S,
            WHEEL_RADIUS: -geometry.radius * rate * WINDOW_S,
        },
    )
