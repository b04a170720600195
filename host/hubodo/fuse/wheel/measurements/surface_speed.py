"""Surface speed: what another odometer, an encoder, says that a wheel's surface moves at.

    s = (1 + k) (v - r y)

Contact speed of the model's README, as in rolling.py; k is the error of the encoder's own scale: the radius
that somebody told it. It is taken for the body's wheels, whether a node sits on them or not.
"""

from __future__ import annotations

from collections.abc import Mapping

from hubodo.fuse.wheel.entries import ENCODER_LEFT, ENCODER_RIGHT, SPEED, TRACK_WIDTH, YAW_RATE, Entry
from hubodo.fuse.wheel.measurements.shared import Row

STATES = (SPEED, YAW_RATE, TRACK_WIDTH, ENCODER_LEFT, ENCODER_RIGHT)

_NOISE = 0.02
"""m/s, 1 sigma in a mean over a window: a few ticks of a coarse encoder. Estimated."""

_SHARE = 0.01
"""Of the speed, 1 sigma, what a wheel slips and bounces from window to window. Estimated."""


def measure(x: list[float], at: Mapping[Entry, int], side: float, contact: float, speed: float) -> Row:
    """Residual in m/s. side: +1 left, -1 right; contact: m, y of the contact; speed: m/s, as told."""
    entry = ENCODER_LEFT if side > 0.0 else ENCODER_RIGHT
    scale, y = 1.0 + x[at[entry]], contact * (1.0 + x[at[TRACK_WIDTH]])
    rate = x[at[YAW_RATE]]
    rolled = x[at[SPEED]] - rate * y
    return (
        speed - scale * rolled,
        _NOISE**2 + (_SHARE * speed) ** 2,
        {SPEED: scale, YAW_RATE: -scale * y, TRACK_WIDTH: -scale * rate * contact, entry: rolled},
    )
