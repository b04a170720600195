"""Roll rate: rates across the axle, rotated by the wheel angle, vanish along the forward axis.

    Im[(W - b E - tau G) e^(iθ_m)] = d Im E_2 cos(camber) (r + g)

Forward component of the angular rate (README of the model), integrated over the window; symbols as in
`yaw.py`. It is zero for a body that only yaws, which determines the wheel angle and the tilt of the spin
axis. Gyros of unequal scale project the yaw rate into it.
"""

from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_DIFFERENCE,
    GYRO_SCALE_Z,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    RATE_BEYOND_RANGE,
    WHEEL_ANGLE,
    YAW_RATE,
)
from hubodo.fuse.wheel.measurements.shared import LinearisedWindow, Row, WindowNoise
from hubodo.fuse.wheel.window import WINDOW_S, Window

STATES = (
    *(YAW_RATE, WHEEL_ANGLE, GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE, GYRO_BIAS_X, GYRO_BIAS_Y),
    *(MISALIGNMENT_Y, MISALIGNMENT_X, CAMBER, GYRO_SCALE_DIFFERENCE),
)


def is_usable(window: Window) -> bool:
    """Return False if a gyro across the axle was saturated."""
    return window.across_clipped == 0.0


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Return residual (rad), variance and derivatives.

    Variance: gyro white noise; while driving, vibration and the vehicle's own roll rate.
    """
    variance = max(noise.gyro, w.gyro_noise)
    if not w.is_stationary:
        variance += noise.axle_flex * w.window.axial_variance + noise.roll_rate
    level_yaw_rate, scale_difference = (
        w.camber_cos * (w.yaw_rate + w.geometry.ground_rate),
        w.x[w.columns[GYRO_SCALE_DIFFERENCE]],
    )
    by_angle = 2.0 * scale_difference * level_yaw_rate * w.double_carrier.real - w.across.real
    # A rate change d of the wheel changes its angle at the middle of the window by d T / 2.
    by_rate = -by_angle * (0.5 * WINDOW_S)
    return (
        w.across.imag - scale_difference * level_yaw_rate * w.double_carrier.imag,
        variance,
        {
            YAW_RATE: scale_difference * w.camber_cos * w.double_carrier.imag - by_rate * w.rate_by_yaw_rate,
            WHEEL_ANGLE: by_angle,
            GYRO_SCALE_Z: -by_rate * w.rate_by_scale,
            GYRO_BIAS_Z: -by_rate * w.rate_by_bias,
            RATE_BEYOND_RANGE: -by_rate,
            GYRO_BIAS_X: w.carrier.imag,
            GYRO_BIAS_Y: w.carrier.real,
            MISALIGNMENT_Y: -w.rate_carrier.imag,
            MISALIGNMENT_X: w.rate_carrier.real,
            CAMBER: -by_rate * w.rate_by_camber
            - scale_difference * w.camber_sin * (w.yaw_rate + w.geometry.ground_rate) * w.double_carrier.imag,
            GYRO_SCALE_DIFFERENCE: level_yaw_rate * w.double_carrier.imag,
        },
    )
