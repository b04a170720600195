"""Position of the antenna, from a truth or a GNSS receiver, in the axes of the track.

    z = p + R(heading) a - d v (cos heading, sin heading) + e

p is the body origin, a the antenna on the vehicle, d the delay of the position time stamps, v the speed, e
the slowly varying error. R(heading) is the rotation by the heading.
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

_SHARED_STATES = (HEADING, SPEED, ANTENNA_X, ANTENNA_Y, POSITION_DELAY)
STATES = (X, POSITION_ERROR_X, *_SHARED_STATES, Y, POSITION_ERROR_Y, *_SHARED_STATES)


class Position(NamedTuple):
    """A measured position: x, y in m; sigma: m, 1 sigma of the white error in each direction."""

    x: float
    y: float
    sigma: float


def measure(x: list[float], columns: Mapping[Entry, int], position: Position) -> tuple[Row, Row]:
    """Return the rows of x and y: residuals (m), variances of the white error, derivatives."""
    variance = position.sigma**2
    sin, cos = math.sin(x[columns[HEADING]]), math.cos(x[columns[HEADING]])
    delay, speed = x[columns[POSITION_DELAY]], x[columns[SPEED]]
    forward, left = x[columns[ANTENNA_X]] - delay * speed, x[columns[ANTENNA_Y]]
    east, north = cos * forward - sin * left, sin * forward + cos * left
    by_east = (-north, -delay * cos, cos, -sin, -speed * cos)
    by_north = (east, -delay * sin, sin, cos, -speed * sin)
    return (
        (
            position.x - x[columns[X]] - east - x[columns[POSITION_ERROR_X]],
            variance,
            {X: 1.0, POSITION_ERROR_X: 1.0, **dict(zip(_SHARED_STATES, by_east, strict=True))},
        ),
        (
            position.y - x[columns[Y]] - north - x[columns[POSITION_ERROR_Y]],
            variance,
            {Y: 1.0, POSITION_ERROR_Y: 1.0, **dict(zip(_SHARED_STATES, by_north, strict=True))},
        ),
    )
