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
    EXCESS,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    WHEEL_ANGLE,
    YAW_RATE,
)
from hubodo.fuse.wheel.measurements.shared import Row, WheelWindow
from hubodo.fuse.wheel.window import WINDOW

STATES = (WHEEL_ANGLE, EXCESS, LEVER_ARM_X, LEVER_ARM_Y, ACCEL_BIAS_X, ACCEL_BIAS_Y)

LEFT_OUT = (GYRO_SCALE_Z, GYRO_BIAS_Z, CAMBER, YAW_RATE)
"""Entries that move the residual but are not corrected by it.

Next to EXCESS, which is free while the gyro is clipped, what it could say of them is lost.
"""

_SHORTEST = 2e-3
"""m; on a shorter arm 30 rad/s make less than 2 m/s²: no more than bias and vibration."""


def measure(w: WheelWindow, noise: WheelNoise) -> Row | None:
    """Residual in m/s; None where the arm is too short to feel the spin.

    Variance: 1 m/s² for what the accelerometers' scale and the bumps of a fast drive make of a force of many
    g (estimated), and vibration.
    """
    x, at = w.x, w.at
    arm = complex(x[at[LEVER_ARM_X]], x[at[LEVER_ARM_Y]])
    length = abs(arm)
    if length < _SHORTEST:
        return None
    unit = arm / length
    along, rate = unit.conjugate(), w.about_axle
    gravity = STANDARD_GRAVITY * w.cos * w.turn.conjugate() * w.window.carrier.conjugate()
    steady = gravity + complex(x[at[ACCEL_BIAS_X]], x[at[ACCEL_BIAS_Y]]) * WINDOW
    felt = w.window.raw_force - steady
    # The direction of the arm counts in what is left across it.
    across = (felt * along).imag / length
    spin = 2.0 * rate * length * WINDOW
    by_angle = (-1j * gravity * along).real
    return (
        (felt * along).real + rate * rate * length * WINDOW,
        (1.0 + noise.vibration**2 * w.window.axial_variance) * WINDOW**2,
        {
            WHEEL_ANGLE: by_angle,
            EXCESS: 0.5 * WINDOW * by_angle - spin,
            LEVER_ARM_X: -rate * rate * WINDOW * unit.real + across * unit.imag,
            LEVER_ARM_Y: -rate * rate * WINDOW * unit.imag - across * unit.real,
            ACCEL_BIAS_X: along.real * WINDOW,
            ACCEL_BIAS_Y: -along.imag * WINDOW,
        },
    )
