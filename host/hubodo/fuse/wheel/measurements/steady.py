"""Node-fixed terms: force and rate that do not rotate during a spin search give arm and tilt.

    f = a + (i w' - w²) rho        q = b + tau w

Specific force f and rate q across the axle (README of the model), complex numbers as in `shared.py`, after
removing the terms that rotate, gravity and the yaw rate: a and b are the biases, rho the lever arm, w the
spin, tau the tilt by which the spin leaks into q. A drive that starts clipped has no slow spin to learn them
from, and with an angle error of a third of a radian tens of m/s² on the arm would be attributed to other
states.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from hubodo.fuse.wheel.config import WheelNoise
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
"""Force x and y, rate x and y; each row is linearised after the update with the one before."""

GRAVITY_SPEED_SIGMA = 0.15
"""m/s, 1 sigma of a speed from the rotation of gravity: braking is uneven, and starts or ends in a window.
Estimated.
"""

ONE_AXIS_SPEED_SIGMA = 0.3
"""m/s, the same where the other accelerometer axis is saturated. The rms errors of drives at 15 to 35 m/s,
seeds 300 and 301, are 0.11 to 0.15 m/s with both axes and 0.24 to 0.36 m/s with one.
"""


class NodeFixedTerms(NamedTuple):
    """Means over samples of the terms fixed in the node: force, m/s², and rate, rad/s, x + iy.

    Attributes
    ----------
    force_variance, rate_variance : variances of each component, from vibration.
    spin : rad/s, w.
    lever_factor : (rad/s)², i w' - w².
    radius : m.
    """

    force: complex
    rate: complex
    force_variance: float
    rate_variance: float
    spin: float
    lever_factor: complex
    radius: float


def measure(
    x: list[float], columns: Mapping[Entry, int], terms: NodeFixedTerms, noise: WheelNoise
) -> tuple[Row, Row, Row, Row]:
    """Return four rows: force x, y (m/s²) and rate x, y (rad/s).

    Variance: effect of a spin error, the residual noise, and other terms that do not rotate for a second,
    bumps and starting turns: the unmodelled force and roll rate of `noise`.
    """
    arm = complex(x[columns[LEVER_ARM_X]], x[columns[LEVER_ARM_Y]])
    tilt = complex(-x[columns[MISALIGNMENT_Y]], x[columns[MISALIGNMENT_X]])
    force = (
        terms.force - complex(x[columns[ACCEL_BIAS_X]], x[columns[ACCEL_BIAS_Y]]) - arm * terms.lever_factor
    )
    rate = terms.rate - complex(x[columns[GYRO_BIAS_X]], x[columns[GYRO_BIAS_Y]]) - tilt * terms.spin
    share = (GRAVITY_SPEED_SIGMA / (terms.radius * terms.spin)) ** 2
    force_variance_total = noise.lateral_force**2 + terms.force_variance + 4.0 * share * abs(terms.force) ** 2
    rate_variance_total = noise.roll_rate**2 + terms.rate_variance + share * abs(terms.rate) ** 2
    by_arm = terms.lever_factor
    return (
        (
            force.real,
            force_variance_total,
            {ACCEL_BIAS_X: 1.0, LEVER_ARM_X: by_arm.real, LEVER_ARM_Y: -by_arm.imag},
        ),
        (
            force.imag,
            force_variance_total,
            {ACCEL_BIAS_Y: 1.0, LEVER_ARM_X: by_arm.imag, LEVER_ARM_Y: by_arm.real},
        ),
        (rate.real, rate_variance_total, {GYRO_BIAS_X: 1.0, MISALIGNMENT_Y: -terms.spin}),
        (rate.imag, rate_variance_total, {GYRO_BIAS_Y: 1.0, MISALIGNMENT_X: terms.spin}),
    )
