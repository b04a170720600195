"""Sideways force: the specific force along the axle equals camber, curve and lever-arm terms.

    ∫ (az - l_x ax + l_y ay) = (lambda g sin(camber) + cos(camber) r R w + a_z) T + 2 w rho · ∫ (rx, ry)

Specific force (README of the model) along the axle, integrated over the window of length T: lambda is +1 on
the left and -1 on the right, g gravity, R the radius, w the rate about the axle, r the yaw rate, r R w the
centripetal acceleration of the hub, a_z the bias. The last term is the Coriolis force on the lever arm rho;
(rx, ry) are gx and gy less bias and the spin leaked by a tilt, which is fixed in the node and causes no such
force. l_x and l_y are the shares of the forces across the axle in the axial accelerometer
(accel_nonorthogonality zy and zx).
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


def is_usable(window: Window) -> bool:
    """Return False if an accelerometer was saturated: those across leak into the one along the axle."""
    return window.force_clipped == 0.0 and window.axial_clipped == 0.0


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Return residual (m/s), variance and derivatives.

    Variance: accelerometer white noise; at standstill, residual motion; while driving, vibration and sway.
    """
    x, columns, window = w.x, w.columns, w.window
    variance = noise.accel + STANDSTILL_FORCE_VARIANCE
    if not w.is_stationary:
        variance = noise.accel + noise.vibration * window.axial_variance + noise.lateral_force
    r, radius, about_axle = w.yaw_rate, w.geometry.radius, w.axle_rate
    leak = window.raw_force
    # Rates across the axle caused by the vehicle's turning alone, less bias and leaked spin.
    spin, tilt = window.spin / WINDOW_S + x[columns[RATE_BEYOND_RANGE]], w.tilt
    yawing = window.raw_across - (w.gyro_bias + tilt * spin) * WINDOW_S
    arm_x, arm_y = x[columns[LEVER_ARM_X]], x[columns[LEVER_ARM_Y]]
    sway, by_bias, by_tilt = 2.0 * spin * yawing, -2.0 * spin * WINDOW_S, 2.0 * spin * spin * WINDOW_S
    by_spin = 2.0 * yawing - 2.0 * spin * WINDOW_S * tilt
    lateral, level = w.camber_cos * r * radius, w.geometry.side * STANDARD_GRAVITY
    residual = window.axial - x[columns[AXIAL_LEAK_X]] * leak.real + x[columns[AXIAL_LEAK_Y]] * leak.imag
    residual = residual - arm_x * sway.real - arm_y * sway.imag
    residual -= (level * w.camber_sin + lateral * about_axle + x[columns[ACCEL_BIAS_Z]]) * WINDOW_S
    return (
        residual,
        variance + w.force_noise,
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
