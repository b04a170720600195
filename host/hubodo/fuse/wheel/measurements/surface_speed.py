"""Surface speed: the speed of a wheel's surface reported by another odometer, an encoder.

    s = (1 + k) (v - r y)

Contact speed (README of the model), symbols as in `rolling.py`; k is the scale error of the encoder, from
the radius it was configured with. It applies to the declared wheels, with or without a node.
"""

from __future__ import annotations

from collections.abc import Mapping

from hubodo.fuse.wheel.entries import ENCODER_LEFT, ENCODER_RIGHT, SPEED, TRACK_WIDTH, YAW_RATE, Entry
from hubodo.fuse.wheel.measurements.shared import Row

STATES = (SPEED, YAW_RATE, TRACK_WIDTH, ENCODER_LEFT, ENCODER_RIGHT)

_SURFACE_SPEED_SIGMA = 0.02
"""m/s, 1 sigma of a mean over a window: a few ticks of a coarse encoder. Estimated."""

_SURFACE_SPEED_SHARE = 0.01
"""Share of the speed, 1 sigma of slip and bounce from window to window. Estimated."""


def measure(x: list[float], columns: Mapping[Entry, int], side: float, contact: float, speed: float) -> Row:
    """Return residual (m/s), variance and derivatives.

    side: +1 left, -1 right; contact: m, lateral position of the contact; speed: m/s, as reported.
    """
    entry = ENCODER_LEFT if side > 0.0 else ENCODER_RIGHT
    scale, y = 1.0 + x[columns[entry]], contact * (1.0 + x[columns[TRACK_WIDTH]])
    rate = x[columns[YAW_RATE]]
    contact_speed = x[columns[SPEED]] - rate * y
    return (
        speed - scale * contact_speed,
        _SURFACE_SPEED_SIGMA**2 + (_SURFACE_SPEED_SHARE * speed) ** 2,
        {SPEED: scale, YAW_RATE: -scale * y, TRACK_WIDTH: -scale * rate * contact, entry: contact_speed},
    )
