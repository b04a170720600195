"""What the stops of a running programme have told so far: enough to know when to stop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.north.averages import Averages, average
from hubodo.sensors.north.circle import summarise
from hubodo.sensors.north.ml import estimate

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
        self._made: list[Averages] = []
        self.stops = 0

    def add(self, t: Array, rate: Array, angle: float) -> float:
        """One stop: t (N,) s, rate (N,) rad/s, the axis at `angle`, rad, from table zero. Gives its mean."""
        length = float(np.median(np.diff(t))) * len(t) / PARTS
        self._made.append(average(t, rate, np.full(len(t), angle), [(0, len(t))], length))
        self.stops += 1
        return float(rate.mean())

    def averages(self) -> Averages:
        """Of the stops added here."""
        fields = [(it.start, it.end, it.y, it.cos, it.sin, it.turned) for it in self._made]
        return Averages(*(np.concatenate(values) for values in zip(*fields, strict=True)))

    def azimuth(self) -> tuple[float, float] | None:
        """Azimuth of table zero and sigma, rad; None before there are FEWEST stops or earlier ones."""
        if self.stops < FEWEST and not self._earlier:
            return None
        own = [self.averages()] if self.stops >= FEWEST else []
        azimuth, sigma, _ = summarise(estimate([*self._earlier, *own], self._horizontal), self._near)
        return azimuth, sigma
