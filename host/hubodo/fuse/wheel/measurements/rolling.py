"""Rolling: without slip the wheel rolls at the speed of the ground under its contact point.

    R (1 + e) p T = (v - r y) T

Contact speed (README of the model): R is the wheel radius, e its relative error, p the mean rolling rate, v
and r speed and yaw rate of the vehicle, y the lateral position of the contact, T the length of the window. A
node whose time stamps are late by d shows the rate at a time d earlier: R (w_1 - w_0) d is added for the
second node, w_0 and w_1 being its rates at the edges.
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

_TYRE_VARIANCE = 1e-8
"""m²; 0.1 mm of tyre deformation in a window, even at standstill. Estimated."""


def is_usable(window: Window) -> bool:
    """Return True: a clipped gyro is compensated by RATE_BEYOND_RANGE."""
    return True


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Return residual (m), variance and derivatives.

    Variance: at standstill, creep; while driving, road roughness along the path.
    """
    x, columns, rate, r = w.x, w.columns, w.rolling_rate, w.yaw_rate
    geometry = w.geometry
    rolling_radius = geometry.radius * (1.0 + x[columns[WHEEL_RADIUS]])
    contact = geometry.contact_y * (1.0 + x[columns[TRACK_WIDTH]])
    # The change of a spin from a search is not measured; used here it would look like a clock delay.
    rate_change = (
        geometry.delay_factor * geometry.radius * w.axle_rate_change if w.window.spin_clipped == 0.0 else 0.0
    )
    return (
        (rolling_radius * rate - x[columns[SPEED]] + r * contact) * WINDOW_S
        + x[columns[TIME_OFFSET]] * rate_change,
        rolling_radius * rolling_radius * w.gyro_noise
        + _TYRE_VARIANCE
        + (0.0 if w.is_stationary else noise.road_roughness * abs(rate)),
        {
            SPEED: WINDOW_S,
            YAW_RATE: -(rolling_radius * w.rate_by_yaw_rate + contact) * WINDOW_S,
            TRACK_WIDTH: -r * geometry.contact_y * WINDOW_S,
            TIME_OFFSET: -rate_change,
            GYRO_SCALE_Z: -rolling_radius * w.rate_by_scale * WINDOW_S,
            GYRO_BIAS_Z: -rolling_radius * w.rate_by_bias * WINDOW_S,
            RATE_BEYOND_RANGE: -rolling_radius * WINDOW_S,
            CAMBER: -rolling_radius * w.rate_by_camber * WINDOW_S,
            WHEEL_RADIUS: -geometry.radius * rate * WINDOW_S,
        },
    )
