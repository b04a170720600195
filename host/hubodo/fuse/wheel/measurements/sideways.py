"""Sideways: the specific force along the axle is what gravity on a leaning wheel and the curve make.

    int (az - l_x ax + l_y ay) = (lambda g sin(camber) + cos(camber) r R w + a_z) T + 2 w rho . int (rx, ry)

The specific force of the model's README along the axle, summed up over the window: w is the rate about the
axle, r R w the centripetal acceleration of the hub in a curve, the last term that of the lever arm rho, which
the spin carries round within the yawing body; (rx, ry) are gx and gy less their bias and the spin that a tilt
lets in, which turns with the node and so makes no such force. l_x and l_y are how much of the forces across
leaks into the axial accelerometer (accel_nonorthogonality zy and zx), a_z its bias.
"""

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_Z,
    AXIAL_LEAK_X,
    AXIAL_LEAK_Y,
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
    YAW_RATE,
)
from hubodo.fuse.wheel.measurements.shared import (
    STANDSTILL_FORCE_VARIANCE,
    LinearisedWindow,
    Row,
    WindowNoise,
)
from hubodo.fuse.wheel.window import WINDOW_S, Window

STATES = (
    *(YAW_RATE, GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE, ACCEL_BIAS_Z, CAMBER),
    *(AXIAL_LEAK_X, AXIAL_LEAK_Y, LEVER_ARM_X, LEVER_ARM_Y),
    *(GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_X, MISALIGNMENT_Y),
)


def usable(window: Window) -> bool:
    """Not where an accelerometer stood at its limit: those across leak into the one along the axle."""
    return window.force_clipped == 0.0 and window.axial_clipped == 0.0


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Residual in m/s.

    Variance: white noise of the accelerometer; at rest, how still a wheel stands; while driving, vibration
    and the swaying of the vehicle.
    """
    x, at, window = w.x, w.columns, w.window
    variance = noise.accel + STANDSTILL_FORCE_VARIANCE
    if not w.is_stationary:
        variance = noise.accel + noise.vibration * window.axial_variance + noise.lateral_force
    r, radius, about_axle = w.yaw_rate, w.geometry.radius, w.axle_rate
    leak = window.raw_force
    # What the vehicle's turning alone makes in the gyros across the axle: less their bias and the spin.
    spin, tilt = (
        window.spin / WINDOW_S + x[at[RATE_BEYOND_RANGE]],
        complex(-x[at[MISALIGNMENT_Y]], x[at[MISALIGNMENT_X]]),
    )
    yawing = window.raw_across - (complex(x[at[GYRO_BIAS_X]], x[at[GYRO_BIAS_Y]]) + tilt * spin) * WINDOW_S
    arm_x, arm_y = x[at[LEVER_ARM_X]], x[at[LEVER_ARM_Y]]
    sway, by_bias, by_tilt = 2.0 * spin * yawing, -2.0 * spin * WINDOW_S, 2.0 * spin * spin * WINDOW_S
    by_spin = 2.0 * yawing - 2.0 * spin * WINDOW_S * tilt
    lateral, level = w.camber_cos * r * radius, w.geometry.side * STANDARD_GRAVITY
    residual = window.axial - x[at[AXIAL_LEAK_X]] * leak.real + x[at[AXIAL_LEAK_Y]] * leak.imag
    residual = residual - arm_x * sway.real - arm_y * sway.imag
    residual -= (level * w.camber_sin + lateral * about_axle + x[at[ACCEL_BIAS_Z]]) * WINDOW_S
    return (
        residual,
        variance,
        {
            YAW_RATE: w.camber_cos * radius * about_axle * WINDOW_S,
            GYRO_SCALE_Z: lateral * w.rate_by_scale * WINDOW_S,
            GYRO_BIAS_Z: lateral * w.rate_by_bias * WINDOW_S,
            RATE_BEYOND_RANGE: lateral * WINDOW_S + arm_x * by_spin.real + arm_y * by_spin.imag,
            ACCEL_BIAS_Z: WINDOW_S,
            CAMBER: (level * w.camber_cos - w.camber_sin * r * radius * about_axle) * WINDOW_S,
            AXIAL_LEAK_X: leak.real,
            AXIAL_LEAK_Y: -leak.imag,
            LEVER_ARM_X: sway.real,
            LEVER_ARM_Y: sway.imag,
            GYRO_BIAS_X: arm_x * by_bias,
            GYRO_BIAS_Y: arm_y * by_bias,
            MISALIGNMENT_X: -arm_y * by_tilt,
            MISALIGNMENT_Y: arm_x * by_tilt,
        },
    )
