"""Positions that somebody else tells, and how far they are off: at random, and slowly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

_LEAST = 0.01
"""m; what is random in the best of positions: RTK and a phase centre that is not a point."""

_OF_SECOND_DIFFERENCES = 0.6745 * np.sqrt(6.0)
"""Median size of the second differences of white noise, in units of its sigma."""


@dataclass(frozen=True, eq=False)
class Positions:
    """Where a point of the vehicle was, in axes that neither turn nor move.

    t: (M,) s on the log's clock, increasing. x, y: (M,) m. sigma: (M,) m, 1 sigma of each as their source
    declares it. antenna: m forward and left of the body origin, 1 sigma of both; None where it is not known.
    """

    t: Array
    x: Array
    y: Array
    sigma: Array
    antenna: tuple[float, float, float] | None = None

    def __len__(self) -> int:
        return len(self.t)

    def select(self, chosen: NDArray[Any]) -> Positions:
        """Those of a mask or of indices, (M,)."""
        return Positions(self.t[chosen], self.x[chosen], self.y[chosen], self.sigma[chosen], self.antenna)

    def thin_out(self, seconds: float) -> Positions:
        """One of every so many seconds: what is neighbouring says little that is new."""
        return self.select(np.unique(np.floor(self.t / seconds), return_index=True)[1])


def estimate_white_sigma(told: Positions, x: Array, y: Array) -> Array:
    """1 sigma of what is random in positions, (M,) m, no more than what is declared and no less than 1 cm.

    x, y: (M,) m, a track at the same times, that is off by what changes slowly. Second differences of the
    error show what is left from one position to the next; half of them may be wild.
    """
    if len(told) < 10:
        return np.maximum(told.sigma, _LEAST)
    bends = np.abs(np.concatenate([np.diff(told.x - x, 2), np.diff(told.y - y, 2)]))
    seen = float(np.median(bends)) / _OF_SECOND_DIFFERENCES
    return np.asarray(np.clip(seen, _LEAST, np.maximum(told.sigma, _LEAST)))
