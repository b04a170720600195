"""Yaw: the rates across the axle, turned upright by the wheel angle, show how fast the vehicle turns.

    Re[(W - b E - tau G) e^(i theta_m)] = (1 + s) cos(camber) (r + g) T + b_r T

The angular rate of the model's README (rigid wheel, Omega = theta' a + r z) along hub up, summed up over the
window: W = int (gx + i gy) e^(ic), E = int e^(ic), G = int gz e^(ic), c the angle since the middle. b is the
bias of the gyros across the axle, s their scale, tau the tilt that lets the spin into them, b_r the constant
yaw rate that gravity makes in a gyro that feels it, g the rate at which the ground turns with the Earth.
"""

from hubodo.fuse.wheel.entries import (
    CAMBER,
    EXCESS,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_Z,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    WHEEL_ANGLE,
    YAW_RATE,
    YAW_RATE_FROM_GRAVITY,
)
from hubodo.fuse.wheel.measurements.shared import Row, WheelWindow, WindowNoise
from hubodo.fuse.wheel.window import WINDOW, Window

STATES = (
    *(YAW_RATE, WHEEL_ANGLE, GYRO_SCALE_Z, GYRO_BIAS_Z, EXCESS, GYRO_BIAS_X, GYRO_BIAS_Y),
    *(MISALIGNMENT_Y, MISALIGNMENT_X, CAMBER, GYRO_SCALE_ACROSS, YAW_RATE_FROM_GRAVITY),
)


def usable(window: Window) -> bool:
    """Not where the gyros across the axle stood at their limit."""
    return window.across_clipped == 0.0


def measure(w: WheelWindow, noise: WindowNoise) -> Row:
    """Residual in rad. Variance: white noise of the gyros; while driving, what vibration adds to them."""
    x, at, r = w.x, w.at, w.yaw_rate + w.geometry.ground_rate
    scale, level, roll = 1.0 + x[at[GYRO_SCALE_ACROSS]], w.cos * r, w.across.imag
    residual = w.across.real - (scale * w.cos * r + x[at[YAW_RATE_FROM_GRAVITY]]) * WINDOW
    variance = max(noise.gyro, w.gyro_noise)
    if not w.resting:
        variance += noise.flex * w.window.axial_variance
    # A faster wheel is further by half a window in its middle.
    by_rate = -roll * (0.5 * WINDOW)
    return (
        residual,
        variance,
        {
            YAW_RATE: scale * w.cos * WINDOW - by_rate * w.rate_by_yaw_rate,
            WHEEL_ANGLE: roll,
            GYRO_SCALE_Z: -by_rate * w.rate_by_scale,
            GYRO_BIAS_Z: -by_rate * w.rate_by_bias,
            EXCESS: -by_rate,
            GYRO_BIAS_X: w.carrier.real,
            GYRO_BIAS_Y: -w.carrier.imag,
            MISALIGNMENT_Y: -w.swing.real,
            MISALIGNMENT_X: -w.swing.imag,
            CAMBER: -by_rate * w.rate_by_camber - scale * w.sin * r * WINDOW,
            GYRO_SCALE_ACROSS: level * WINDOW,
            YAW_RATE_FROM_GRAVITY: WINDOW,
        },
    )
