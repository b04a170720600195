"""Position: where the vehicle is, told by somebody else.

    x = X,  y = Y

A point of the truth or of a GNSS receiver in the axes of the track, as `calibrate wheels` has them.
"""

from collections.abc import Mapping
from typing import NamedTuple

from hubodo.fuse.wheel.entries import Entry, X, Y
from hubodo.fuse.wheel.measurements.shared import Row

STATES = (X, Y)


class Position(NamedTuple):
    """x, y: m; sigma: m, 1 sigma in each direction."""

    x: float
    y: float
    sigma: float


def measure(x: list[float], at: Mapping[Entry, int], told: Position) -> tuple[Row, Row]:
    """Residuals in m. Variance: that of the position, as its source declares it."""
    variance = told.sigma**2
    return (told.x - x[at[X]], variance, {X: 1.0}), (told.y - x[at[Y]], variance, {Y: 1.0})
