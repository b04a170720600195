"""Phase of gravity in one axis: measures the wheel angle while the other accelerometer axis is saturated.

    θ_g = θ + p T / 2

θ_g is the wheel angle at the middle of the window at which the rotation of gravity passes it, fitted over the
last windows by `single_axis_gravity.py`; θ the wheel angle at the start, p the rate about the axle, T the
length of the window.
"""

from __future__ import annotations

import cmath

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    RATE_BEYOND_RANGE,
    WHEEL_ANGLE,
    YAW_RATE,
)
from hubodo.fuse.wheel.measurements.shared import LinearisedWindow, Row
from hubodo.fuse.wheel.thresholds import HARD_ACCELERATION
from hubodo.fuse.wheel.window import WINDOW_S

STATES = (WHEEL_ANGLE, RATE_BEYOND_RANGE)

UNCORRECTED_STATES = (GYRO_SCALE_Z, GYRO_BIAS_Z, CAMBER, YAW_RATE)
"""Entries that the residual depends on but that it does not correct, beside the free RATE_BEYOND_RANGE."""

_PHASE_SIGMA = HARD_ACCELERATION / STANDARD_GRAVITY
"""rad, 1 sigma: braking that the slope of the spin does not show tilts the force by so much, for the four
windows that share a fit."""


def measure(w: LinearisedWindow, gravity_angle: float) -> Row:
    """Return residual (rad), variance and derivatives; gravity_angle: rad, θ_g."""
    return (
        cmath.phase(cmath.exp(1j * gravity_angle) * w.rotation.conjugate()),
        _PHASE_SIGMA**2,
        {WHEEL_ANGLE: 1.0, RATE_BEYOND_RANGE: 0.5 * WINDOW_S},
    )
