"""Forward force: the specific force along the vehicle equals wheel acceleration plus slope.

    Im[(F - a E - rho L) e^(iθ_m)] = R (w_1 - w_0) + n T

Specific force (README of the model) along forward, integrated over the window of length T: F = ∫ (ax + i ay)
e^(ic), E = ∫ e^(ic), c the angle since the middle, θ_m the wheel angle at the middle, a the bias of the
accelerometers, R the wheel radius, w_0 and w_1 the rate about the axle at the edges, n the force of a slope.
The force on a lever arm rho is (i w' - w²) rho; rotated, it is the derivative of i w e^(ic) rho. So L is the
difference of that between the edges and contains centripetal and tangential terms. The hub moves at R w,
with or without camber.
"""

from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    CAMBER,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    RATE_BEYOND_RANGE,
    SLOPE,
    WHEEL_ANGLE,
    YAW_RATE,
)
from hubodo.fuse.wheel.measurements.shared import (
    STANDSTILL_FORCE_VARIANCE,
    LinearisedWindow,
    Row,
    WindowNoise,
)
from hubodo.fuse.wheel.thresholds import HARD_ACCELERATION
from hubodo.fuse.wheel.window import WINDOW_S, Window

STATES = (
    *(YAW_RATE, SLOPE, WHEEL_ANGLE, GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE),
    *(LEVER_ARM_X, LEVER_ARM_Y, ACCEL_BIAS_X, ACCEL_BIAS_Y, CAMBER),
)

_CLIPPED_FORCE_SIGMA = HARD_ACCELERATION * WINDOW_S
"""m/s, 1 sigma; with a clipped gz the change of the wheel rate is unknown."""


def is_usable(window: Window) -> bool:
    """Return False if an accelerometer across the axle was saturated."""
    return window.force_clipped == 0.0


def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
    """Return residual (m/s), variance and derivatives.

    Variance: accelerometer white noise; at standstill, residual motion; while driving, vibration and forward
    force that is not explained by the wheel's acceleration; that of a second accelerometer while it replaces
    a saturated one.
    """
    window = w.window
    variance = noise.accel + STANDSTILL_FORCE_VARIANCE
    if not w.is_stationary:
        force_variance = noise.forward_force if window.spin_clipped == 0.0 else _CLIPPED_FORCE_SIGMA**2
        variance = noise.accel + noise.vibration * window.axial_variance + force_variance
    force, lever, carrier = w.force, w.lever, w.carrier
    # A rate change d of the wheel changes its angle at the middle of the window by d T / 2.
    by_rate = force.real * (0.5 * WINDOW_S)
    return (
        force.imag - w.geometry.radius * w.axle_rate_change - w.x[w.columns[SLOPE]] * WINDOW_S,
        variance + w.force_noise + noise.beyond_range * window.beyond_range,
        {
            YAW_RATE: -by_rate * w.rate_by_yaw_rate,
            SLOPE: WINDOW_S,
            WHEEL_ANGLE: -force.real,
            GYRO_SCALE_Z: -by_rate * w.rate_by_scale,
            GYRO_BIAS_Z: -by_rate * w.rate_by_bias,
            RATE_BEYOND_RANGE: -by_rate,
            LEVER_ARM_X: lever.imag,
            LEVER_ARM_Y: lever.real,
            ACCEL_BIAS_X: carrier.imag,
            ACCEL_BIAS_Y: carrier.real,
            CAMBER: -by_rate * w.rate_by_camber,
        },
    )
