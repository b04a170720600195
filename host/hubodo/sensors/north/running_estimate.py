"""Running azimuth estimate from the stops measured so far, for ending a programme at the required sigma."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.north.averages import Averages, average_spans
from hubodo.sensors.north.circular import summarise_azimuth
from hubodo.sensors.north.likelihood import estimate_earth_rate

AVERAGES_PER_STOP = 4
MIN_ESTIMATE_STOPS = 4
"""Stops, before anything is said."""


class RunningEstimate:
    """The azimuth estimate from all stops of one axis so far.

    horizontal: Earth rate along the axis when it points north, rad/s. earlier: averages of earlier
    records. near: approximate azimuth of table zero, rad.
    """

    def __init__(
        self, horizontal: float, earlier: Sequence[Averages] = (), near: float | None = None
    ) -> None:
        self._horizontal, self._earlier, self._near = horizontal, tuple(earlier), near
        self._averages: list[Averages] = []
        self.stops = 0

    def add_stop(self, t: Array, rate: Array, angle: float) -> float:
        """Add a stop, t (N,) s, rate (N,) rad/s, with the axis at `angle` (rad), and return its mean rate."""
        length = float(np.median(np.diff(t))) * len(t) / AVERAGES_PER_STOP
        self._averages.append(average_spans(t, rate, np.full(len(t), angle), [(0, len(t))], length))
        self.stops += 1
        return float(rate.mean())

    def averages(self) -> Averages:
        """Return the averages of the stops added."""
        fields = [(one.start, one.end, one.y, one.cos, one.sin, one.turned) for one in self._averages]
        return Averages(*(np.concatenate(values) for values in zip(*fields, strict=True)))

    def azimuth(self) -> tuple[float, float] | None:
        """Return azimuth of table zero and its sigma, rad; None with too few stops and no earlier records."""
        if self.stops < MIN_ESTIMATE_STOPS and not self._earlier:
            return None
        new_averages = [self.averages()] if self.stops >= MIN_ESTIMATE_STOPS else []
        azimuth, sigma, _ = summarise_azimuth(
            estimate_earth_rate([*self._earlier, *new_averages], self._horizontal), self._near
        )
        return azimuth, sigma
