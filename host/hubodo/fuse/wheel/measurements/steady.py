"""Steady: what turns with the node, while a clipped spin is searched for, shows its lever arm and its tilt.

    f = a + (i w' - w²) rho        q = b + tau w

Specific force and rates across the axle of the model's README, complex numbers as in shared.py, less what
goes round in them with gravity and the vehicle's turning: a and b are the biases, rho the lever arm, tau the
tilt that lets the spin w in. A drive that begins clipped has seen no slow spin: turned by an angle that is a
third of a radian off, tens of m/s² on an arm would be taken for others.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    Entry,
)
from hubodo.fuse.wheel.measurements.shared import Row

STATES = (
    *(ACCEL_BIAS_X, LEVER_ARM_X, LEVER_ARM_Y, ACCEL_BIAS_Y, LEVER_ARM_X, LEVER_ARM_Y),
    *(GYRO_BIAS_X, MISALIGNMENT_Y, GYRO_BIAS_Y, MISALIGNMENT_X),
)

N_ROWS = 4
"""Force and rate, x and y of each: each is worked in about what the one before has left."""

_SPIN = 0.15
"""m/s by which a wheel may be off the speed that gravity shows: vehicles brake unevenly. Estimated."""

_FORCE, _RATE = 0.3, 0.02
"""m/s² and rad/s, 1 sigma of what else does not turn for a second: bumps; turns that begin. Estimated."""


class NodeFixedTerms(NamedTuple):
    """What does not go round, means of samples: force, m/s²; rate, rad/s; x + iy of node axes.

    force_variance, rate_variance: of each part, of what shakes. spin: rad/s, w; square: (rad/s)²,
    i w' - w². radius: m.
    """

    force: complex
    rate: complex
    force_variance: float
    rate_variance: float
    spin: float
    lever_factor: complex
    radius: float


def measure(x: list[float], at: Mapping[Entry, int], seen: NodeFixedTerms) -> tuple[Row, Row, Row, Row]:
    """Residuals in m/s² and rad/s. Variance: of what a spin that is off makes of them, and what is left."""
    arm = complex(x[at[LEVER_ARM_X]], x[at[LEVER_ARM_Y]])
    tilt = complex(-x[at[MISALIGNMENT_Y]], x[at[MISALIGNMENT_X]])
    force = seen.force - complex(x[at[ACCEL_BIAS_X]], x[at[ACCEL_BIAS_Y]]) - arm * seen.lever_factor
    rate = seen.rate - complex(x[at[GYRO_BIAS_X]], x[at[GYRO_BIAS_Y]]) - tilt * seen.spin
    share = (_SPIN / (seen.radius * seen.spin)) ** 2
    of_force = _FORCE**2 + seen.force_variance + 4.0 * share * abs(seen.force) ** 2
    of_rate = _RATE**2 + seen.rate_variance + share * abs(seen.rate) ** 2
    by_arm = seen.lever_factor
    return (
        (force.real, of_force, {ACCEL_BIAS_X: 1.0, LEVER_ARM_X: by_arm.real, LEVER_ARM_Y: -by_arm.imag}),
        (force.imag, of_force, {ACCEL_BIAS_Y: 1.0, LEVER_ARM_X: by_arm.imag, LEVER_ARM_Y: by_arm.real}),
        (rate.real, of_rate, {GYRO_BIAS_X: 1.0, MISALIGNMENT_Y: -seen.spin}),
        (rate.imag, of_rate, {GYRO_BIAS_Y: 1.0, MISALIGNMENT_X: seen.spin}),
    )
