"""Position: where a point of the vehicle was, told by somebody else.

    z = p + R(heading) a - d v (cos heading, sin heading) + e

A point of the truth or of a GNSS receiver in the axes of the track, as `calibrate wheels` has them: p is the
body origin, a the antenna on the vehicle, d how much later the time stamps of the positions are, v the speed,
and e the part of the error that changes slowly.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from hubodo.fuse.wheel.entries import (
    ANTENNA_X,
    ANTENNA_Y,
    HEADING,
    POSITION_DELAY,
    POSITION_ERROR_X,
    POSITION_ERROR_Y,
    SPEED,
    Entry,
    X,
    Y,
)
from hubodo.fuse.wheel.measurements.shared import Row

_BOTH = (HEADING, SPEED, ANTENNA_X, ANTENNA_Y, POSITION_DELAY)
STATES = (X, POSITION_ERROR_X, *_BOTH, Y, POSITION_ERROR_Y, *_BOTH)


class Position(NamedTuple):
    """x, y: m; sigma: m, 1 sigma in each direction of what is random from one position to the next."""

    x: float
    y: float
    sigma: float


def measure(x: list[float], at: Mapping[Entry, int], told: Position) -> tuple[Row, Row]:
    """Residuals in m. Variance: of what is random in the position."""
    variance = told.sigma**2
    sin, cos = math.sin(x[at[HEADING]]), math.cos(x[at[HEADING]])
    delay, speed = x[at[POSITION_DELAY]], x[at[SPEED]]
    forward, left = x[at[ANTENNA_X]] - delay * speed, x[at[ANTENNA_Y]]
    east, north = cos * forward - sin * left, sin * forward + cos * left
    by_east = (-north, -delay * cos, cos, -sin, -speed * cos)
    by_north = (east, -delay * sin, sin, cos, -speed * sin)
    return (
        (
            told.x - x[at[X]] - east - x[at[POSITION_ERROR_X]],
            variance,
            {X: 1.0, POSITION_ERROR_X: 1.0, **dict(zip(_BOTH, by_east, strict=True))},
        ),
        (
            told.y - x[at[Y]] - north - x[at[POSITION_ERROR_Y]],
            variance,
            {Y: 1.0, POSITION_ERROR_Y: 1.0, **dict(zip(_BOTH, by_north, strict=True))},
        ),
    )
