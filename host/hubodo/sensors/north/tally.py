"""What the stops of a running programme have told so far: enough to know when to stop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hubodo.sensors.north.averages import Averages
from hubodo.sensors.north.circle import summarise
from hubodo.sensors.north.ml import estimate

Array = NDArray[np.float64]

PARTS = 4
FEWEST = 4
"""Stops, before anything is said."""


class Tally:
    """Stops of one axis, added as they are made.

    horizontal: rad/s that the axis feels when it points north. earlier: averages of records before this one.
    near: rad, about where table zero points.
    """

    def __init__(
        self, horizontal: float, earlier: Sequence[Averages] = (), near: float | None = None
    ) -> None:
        self._horizontal, self._earlier, self._near = horizontal, tuple(earlier), near
        self._rows: list[tuple[float, ...]] = []
        self.stops = 0

    def add(self, t: Array, rate: Array, angle: float) -> float:
        """One stop: t (N,) s, rate (N,) rad/s, the axis at `angle`, rad, from table zero. Gives its mean."""
        step = float(np.median(np.diff(t)))
        for part in np.array_split(np.arange(len(t)), PARTS):
            self._rows.append(
                (
                    float(t[part[0]]),
                    float(t[part[-1]]) + step,
                    float(rate[part].mean()),
                    math.cos(angle),
                    math.sin(angle),
                    0.0,
                )
            )
        self.stops += 1
        return float(rate.mean())

    def averages(self) -> Averages:
        """Of the stops added here."""
        return Averages(*np.array(self._rows).T)

    def azimuth(self) -> tuple[float, float] | None:
        """Azimuth of table zero and sigma, rad; None before there are FEWEST stops or earlier ones."""
        if self.stops < FEWEST and not self._earlier:
            return None
        own = [self.averages()] if self.stops >= FEWEST else []
        azimuth, sigma, _ = summarise(estimate([*self._earlier, *own], self._horizontal), self._near)
        return azimuth, sigma
