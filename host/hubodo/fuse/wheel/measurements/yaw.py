"""Yaw: the rates across the axle, turned upright by the wheel angle, show how fast the vehicle turns.

    Re[(W - b E - tau G) e^(i theta_m)] = ((1 + s) T + d Re E_2) cos(camber) (r + g) + b_r T - d_t r' T

The angular rate of the model's README (rigid wheel, Omega = theta' a + r z) along hub up, summed up over the
window: W = int (gx + i gy) e^(ic), E = int e^(ic), G = int gz e^(ic), c the angle since the middle. b is the
bias of the gyros across the axle, s their scale, d half of what x has more of it than y, which turns twice as
fast as the wheel: E_2 = e^(2i theta_m) int e^(2ic). Time stamps that are late by d_t show the yaw rate of d_t
before: r' is its change. tau the tilt that lets the spin into them, b_r the constant
yaw rate that gravity makes in a gyro that feels it, g the rate at which the ground turns with the Earth.
"""

from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_DIFFERENCE,
    GYRO_SCALE_Z,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    RATE_BEYOND_RANGE,
    TIME_OFFSET,
    WHEEL_ANGLE,
    YAW_RATE,
    YAW_RATE_FROM_GRAVITY,
)
from hubodo.fuse.wheel.measurements.shared import LinearisedWindow, Row, WindowNoise
from hubodo.fuse.wheel.window import WINDOW_S, Window

STATES = (
    *(
        YAW_RATE,
        TIME_OFFSET,
        WHEEL_ANGLE,
        GYRO_SCALE_Z,
        GYRO_BIAS_Z,
        RATE_BEYOND_RANGE,
        GYRO_BIAS_X,
        GYRO_BIAS_Y,
    ),
    *(MISALIGNMENT_Y, MISALIGNMENT_X, CAMBER),
    *(GYRO_SCALE_ACROSS, GYRO_SCALE_DIFFERENCE, YAW_RATE_FROM_GRAVITY),
)


def usable(window: Window) -> bool:
    """Not where the gyros across the axle stood at their limit."""
    return window.across_clipped == 0.0


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Residual in rad.

    Variance: white noise of the gyros; while driving, what vibration adds to them, and the second order of
    the lateness, half of its square times the change of r'.
    """
    x, at, r = w.x, w.columns, w.yaw_rate + w.geometry.ground_rate
    level, uneven = w.camber_cos * r, x[at[GYRO_SCALE_DIFFERENCE]]
    # By each rad/s of yaw, s.
    scale = (1.0 + x[at[GYRO_SCALE_ACROSS]]) * WINDOW_S + uneven * w.double_carrier.real
    # Where the spin is searched for, an angle that is off changes the yaw rate as well.
    late = w.geometry.delay_factor * w.yaw_change if w.window.spin_clipped == 0.0 else 0.0
    residual = w.across.real - scale * level - x[at[YAW_RATE_FROM_GRAVITY]] * WINDOW_S
    residual += x[at[TIME_OFFSET]] * late
    variance = max(noise.gyro, w.gyro_noise)
    if not w.is_stationary:
        variance += noise.axle_flex * w.window.axial_variance
        variance += (
            0.5 * x[at[TIME_OFFSET]] ** 2 * w.geometry.delay_factor * w.yaw_change_step / WINDOW_S
        ) ** 2
    # A faster wheel is further by half a window in its middle.
    by_angle = w.across.imag - 2.0 * uneven * level * w.double_carrier.imag
    by_rate = -by_angle * (0.5 * WINDOW_S)
    return (
        residual,
        variance,
        {
            YAW_RATE: scale * w.camber_cos - by_rate * w.rate_by_yaw_rate,
            TIME_OFFSET: -late,
            WHEEL_ANGLE: by_angle,
            GYRO_SCALE_Z: -by_rate * w.rate_by_scale,
            GYRO_BIAS_Z: -by_rate * w.rate_by_bias,
            RATE_BEYOND_RANGE: -by_rate,
            GYRO_BIAS_X: w.carrier.real,
            GYRO_BIAS_Y: -w.carrier.imag,
            MISALIGNMENT_Y: -w.swing.real,
            MISALIGNMENT_X: -w.swing.imag,
            CAMBER: -by_rate * w.rate_by_camber - scale * w.camber_sin * r,
            GYRO_SCALE_ACROSS: level * WINDOW_S,
            GYRO_SCALE_DIFFERENCE: level * w.double_carrier.real,
            YAW_RATE_FROM_GRAVITY: WINDOW_S,
        },
    )
