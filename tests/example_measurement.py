"""Vertical force at the hub: an example of a new measurement of the wheel filter, as its recipe asks.

    Re[(F - a E - rho L) e^(iθ_m)] = (g cos(camber) - lambda r R w sin(camber)) T

Specific force (README of the model) along the wheel plane's upward direction, integrated over the window of
length T; F, a, E, rho, L and θ_m as in `forward.py`. g is gravity, lambda is +1 on the left and -1 on the
right, r R w the centripetal acceleration of the hub.
"""

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    CAMBER,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    RATE_BEYOND_RANGE,
    WHEEL_ANGLE,
    YAW_RATE,
)
from hubodo.fuse.wheel.measurements.shared import LinearisedWindow, Row, WindowNoise
from hubodo.fuse.wheel.window import WINDOW_S, Window

STATES = (
    *(YAW_RATE, WHEEL_ANGLE, GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE),
    *(LEVER_ARM_X, LEVER_ARM_Y, ACCEL_BIAS_X, ACCEL_BIAS_Y, CAMBER),
)

_FORCE_VARIANCE = (10.0 * WINDOW_S) ** 2
"""(m/s)²; a scale error of the accelerometers, 1 % of gravity, is constant and no entry of the state. Over
the 10 000 windows of a quarter of an hour it counts as white noise of 100 times 0.1 m/s². Estimated.
"""


def is_usable(window: Window) -> bool:
    """Return False if an accelerometer across the axle was saturated."""
    return window.force_clipped == 0.0


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Return residual (m/s), variance and derivatives.

    Variance: accelerometer white noise and the scale error.
    """
    force, lever, carrier = w.force, w.lever, w.carrier
    side, hub_force = w.geometry.side, w.geometry.radius * w.yaw_rate
    lateral = side * w.camber_sin * hub_force
    # A wheel that turns faster is turned further by half a window in the middle of the window.
    by_angle = force.imag
    by_rate = by_angle * (0.5 * WINDOW_S) - lateral * WINDOW_S
    return (
        force.real - (STANDARD_GRAVITY * w.camber_cos - lateral * w.axle_rate) * WINDOW_S,
        noise.accel + _FORCE_VARIANCE,
        {
            YAW_RATE: by_angle * (0.5 * WINDOW_S) * w.rate_by_yaw_rate
            - side * w.camber_sin * w.geometry.radius * w.axle_rate * WINDOW_S,
            WHEEL_ANGLE: by_angle,
            GYRO_SCALE_Z: by_rate * w.rate_by_scale,
            GYRO_BIAS_Z: by_rate * w.rate_by_bias,
            RATE_BEYOND_RANGE: by_rate,
            LEVER_ARM_X: lever.real,
            LEVER_ARM_Y: -lever.imag,
            ACCEL_BIAS_X: carrier.real,
            ACCEL_BIAS_Y: -carrier.imag,
            CAMBER: by_angle * (0.5 * WINDOW_S) * w.rate_by_camber
            - (STANDARD_GRAVITY * w.camber_sin + side * w.camber_cos * hub_force * w.axle_rate) * WINDOW_S,
        },
    )
