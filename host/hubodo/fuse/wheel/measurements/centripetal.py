"""Centripetal: the force towards the axle shows a spin that is beyond the gyro about it.

    int f . rho/|rho| = (g along rho + a along rho - w² |rho|) T

The specific force of the model's README along the lever arm rho: gravity is taken out with the wheel angle,
a is the bias of the accelerometers, w the rate about the axle. Along the arm the force of spin-up vanishes.
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
from hubodo.fuse.wheel.window import WINDOW_S

STATES = (WHEEL_ANGLE, RATE_BEYOND_RANGE, LEVER_ARM_X, LEVER_ARM_Y, ACCEL_BIAS_X, ACCEL_BIAS_Y)

UNCORRECTED_STATES = (GYRO_SCALE_Z, GYRO_BIAS_Z, CAMBER, YAW_RATE)
"""Entries that move the residual but are not corrected by it.

Next to EXCESS, which is free while the gyro is clipped, what it could say of them is lost.
"""

_SHORTEST = 2e-3
"""m; on a shorter arm 30 rad/s make less than 2 m/s²: no more than bias and vibration."""


def measure(w: LinearisedWindow, noise: WheelNoise) -> Row | None:
    """Residual in m/s; None where the arm is too short to feel the spin.

    Variance: 1 m/s² for what the accelerometers' scale and the bumps of a fast drive make of a force of many
    g (estimated), and vibration.
    """
    x, at = w.x, w.columns
    arm = complex(x[at[LEVER_ARM_X]], x[at[LEVER_ARM_Y]])
    length = abs(arm)
    if length < _SHORTEST:
        return None
    unit = arm / length
    along, rate = unit.conjugate(), w.axle_rate
    gravity = STANDARD_GRAVITY * w.camber_cos * w.rotation.conjugate() * w.window.carrier.conjugate()
    steady = gravity + complex(x[at[ACCEL_BIAS_X]], x[at[ACCEL_BIAS_Y]]) * WINDOW_S
    felt = w.window.raw_force - steady
    # The direction of the arm counts in what is left across it.
    across = (felt * along).imag / length
    spin = 2.0 * rate * length * WINDOW_S
    by_angle = (-1j * gravity * along).real
    return (
        (felt * along).real + rate * rate * length * WINDOW_S,
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
