"""Centripetal force: measures a spin beyond the range of the gyro about the axle.

    ∫ f · rho/|rho| = (g along rho + a along rho - w² |rho|) T

Specific force (README of the model) along the lever arm rho: gravity is removed with the wheel angle, a is
the bias of the accelerometers, w the rate about the axle, T the length of the window. The force of spin-up
is perpendicular to the arm.
"""

from __future__ import annotations

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelNoise
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
from hubodo.fuse.wheel.measurements.shared import LinearisedWindow, Row
from hubodo.fuse.wheel.thresholds import MIN_ARM_LENGTH
from hubodo.fuse.wheel.window import WINDOW_S

STATES = (WHEEL_ANGLE, RATE_BEYOND_RANGE, LEVER_ARM_X, LEVER_ARM_Y, ACCEL_BIAS_X, ACCEL_BIAS_Y)

UNCORRECTED_STATES = (GYRO_SCALE_Z, GYRO_BIAS_Z, CAMBER, YAW_RATE)
"""Entries that the residual depends on but that it does not correct.

Beside RATE_BEYOND_RANGE, which is free while the gyro is clipped, it holds no information about them.
"""


def measure(w: LinearisedWindow, noise: WheelNoise) -> Row | None:
    """Return residual (m/s), variance and derivatives; None if the arm is too short.

    Variance: (1 m/s²)² for accelerometer scale and bumps at a force of many g (estimated), and vibration.
    """
    x, columns = w.x, w.columns
    arm = complex(x[columns[LEVER_ARM_X]], x[columns[LEVER_ARM_Y]])
    length = abs(arm)
    if length < MIN_ARM_LENGTH:
        return None
    unit = arm / length
    along, rate = unit.conjugate(), w.axle_rate
    gravity = STANDARD_GRAVITY * w.camber_cos * w.rotation.conjugate() * w.window.carrier.conjugate()
    steady = gravity + complex(x[columns[ACCEL_BIAS_X]], x[columns[ACCEL_BIAS_Y]]) * WINDOW_S
    arm_force = w.window.raw_force - steady
    # A change of the arm's direction acts on the residual through the force perpendicular to the arm.
    across = (arm_force * along).imag / length
    spin = 2.0 * rate * length * WINDOW_S
    by_angle = (-1j * gravity * along).real
    return (
        (arm_force * along).real + rate * rate * length * WINDOW_S,
        (1.0 + noise.vibration_share**2 * w.window.axial_variance) * WINDOW_S**2,
        {
            WHEEL_ANGLE: by_angle,
            RATE_BEYOND_RANGE: 0.5 * WINDOW_S * by_angle - spin,
            LEVER_ARM_X: -rate * rate * WINDOW_S * unit.real + across * unit.imag,
            LEVER_ARM_Y: -rate * rate * WINDOW_S * unit.imag - across * unit.real,
            ACCEL_BIAS_X: along.real * WINDOW_S,
            ACCEL_BIAS_Y: -along.imag * WINDOW_S,
        },
    )
