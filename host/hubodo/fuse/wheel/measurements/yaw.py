"""Yaw rate: rates across the axle, rotated upright by the wheel angle.

    Re[(W - b E - tau G) e^(iθ_m)] = ((1 + s) T + d Re E_2) cos(camber) (r + g) + b_r T - d_t r' T

Angular rate (README of the model: rigid wheel, Ω = θ' a + r z) along hub up, integrated over the window of
length T: W = ∫ (gx + i gy) e^(ic), E = ∫ e^(ic), G = ∫ gz e^(ic), c the angle since the middle, θ_m the
wheel angle at the middle. b is the bias of the gyros across the axle, tau the tilt by which the spin leaks
into them, s their scale error, d half of the difference of the scale errors of x and y, which rotates twice
as fast as the wheel: E_2 = e^(2iθ_m) ∫ e^(2ic). r is the yaw rate, g the rotation of the ground with the
Earth, b_r the constant yaw rate caused by g-sensitivity. Time stamps late by d_t show the yaw rate at a time
d_t earlier; r' is its derivative.
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


def is_usable(window: Window) -> bool:
    """Return False if a gyro across the axle was saturated."""
    return window.across_clipped == 0.0


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Return residual (rad), variance and derivatives.

    Variance: gyro white noise; while driving, vibration and the second-order term of the delay, half of its
    square times the change of r'.
    """
    x, columns, r = w.x, w.columns, w.yaw_rate + w.geometry.ground_rate
    level_yaw_rate, scale_difference = w.camber_cos * r, x[columns[GYRO_SCALE_DIFFERENCE]]
    # Derivative of the integral by the yaw rate, s.
    scale = (1.0 + x[columns[GYRO_SCALE_ACROSS]]) * WINDOW_S + scale_difference * w.double_carrier.real
    # During a spin search an angle error changes the yaw rate as well.
    yaw_change = w.geometry.delay_factor * w.yaw_change if w.window.spin_clipped == 0.0 else 0.0
    residual = w.across.real - scale * level_yaw_rate - x[columns[YAW_RATE_FROM_GRAVITY]] * WINDOW_S
    residual += x[columns[TIME_OFFSET]] * yaw_change
    variance = max(noise.gyro, w.gyro_noise)
    if not w.is_stationary:
        variance += noise.axle_flex * w.window.axial_variance
        variance += (
            0.5 * x[columns[TIME_OFFSET]] ** 2 * w.geometry.delay_factor * w.yaw_change_step / WINDOW_S
        ) ** 2
    # A rate change d of the wheel changes its angle at the middle of the window by d T / 2.
    by_angle = w.across.imag - 2.0 * scale_difference * level_yaw_rate * w.double_carrier.imag
    by_rate = -by_angle * (0.5 * WINDOW_S)
    return (
        residual,
        variance,
        {
            YAW_RATE: scale * w.camber_cos - by_rate * w.rate_by_yaw_rate,
            TIME_OFFSET: -yaw_change,
            WHEEL_ANGLE: by_angle,
            GYRO_SCALE_Z: -by_rate * w.rate_by_scale,
            GYRO_BIAS_Z: -by_rate * w.rate_by_bias,
            RATE_BEYOND_RANGE: -by_rate,
            GYRO_BIAS_X: w.carrier.real,
            GYRO_BIAS_Y: -w.carrier.imag,
            MISALIGNMENT_Y: -w.rate_carrier.real,
            MISALIGNMENT_X: -w.rate_carrier.imag,
            CAMBER: -by_rate * w.rate_by_camber - scale * w.camber_sin * r,
            GYRO_SCALE_ACROSS: level_yaw_rate * WINDOW_S,
            GYRO_SCALE_DIFFERENCE: level_yaw_rate * w.double_carrier.real,
            YAW_RATE_FROM_GRAVITY: WINDOW_S,
        },
    )
