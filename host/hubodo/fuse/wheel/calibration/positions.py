"""Positions from another source, and the size of their white error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

_MIN_WHITE_SIGMA = 0.01
"""m, white error of the best positions: RTK and a phase centre that is not a point."""

_SECOND_DIFFERENCE_MEDIAN = 0.6745 * np.sqrt(6.0)
"""Median absolute second difference of white noise, in units of its sigma."""


@dataclass(frozen=True, eq=False)
class Positions:
    """Positions of a point of the vehicle in fixed axes.

    Attributes
    ----------
    t : (M,) s on the log's clock, increasing.
    x, y : (M,) m.
    sigma : (M,) m, 1 sigma declared by their source.
    antenna : m forward and left of the body origin, and 1 sigma of both; None if unknown.
    """

    t: Array
    x: Array
    y: Array
    sigma: Array
    antenna: tuple[float, float, float] | None = None

    def __len__(self) -> int:
        return len(self.t)

    def select(self, selection: NDArray[Any]) -> Positions:
        """Return the positions of a mask or of indices, (M,)."""
        return Positions(
            self.t[selection], self.x[selection], self.y[selection], self.sigma[selection], self.antenna
        )

    def thin_out(self, seconds: float) -> Positions:
        """Return the first position in each interval of `seconds`."""
        return self.select(np.unique(np.floor(self.t / seconds), return_index=True)[1])


def estimate_white_sigma(positions: Positions, x: Array, y: Array) -> Array:
    """Return 1 sigma of the white error of positions, (M,) m, between 1 cm and the declared sigma.

    x, y: (M,) m, track at the same times, whose error varies slowly. The median of the second differences of
    the error is robust to half of them being outliers.
    """
    if len(positions) < 10:
        return np.maximum(positions.sigma, _MIN_WHITE_SIGMA)
    second_differences = np.abs(np.concatenate([np.diff(positions.x - x, 2), np.diff(positions.y - y, 2)]))
    white_sigma = float(np.median(second_differences)) / _SECOND_DIFFERENCE_MEDIAN
    return np.asarray(np.clip(white_sigma, _MIN_WHITE_SIGMA, np.maximum(positions.sigma, _MIN_WHITE_SIGMA)))
