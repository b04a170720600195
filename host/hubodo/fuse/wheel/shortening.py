"""What a heading that is not known does to the place besides turning its way sideways: makes it shorter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array


def shortened(variance: float) -> float:
    """By which share, rms, a way is shorter whose heading is off by d, of `variance`, rad²: E (1 - cos d)².

    A derivative turns a way sideways only. For a normal d; 3/4 of the variance squared where that is small.
    """
    square = 1.5 - 2.0 * math.exp(-0.5 * variance) + 0.5 * math.exp(-2.0 * variance)
    # Below a microradian rounding would make it negative.
    return math.sqrt(max(square, 0.0))


@dataclass
class Shortening:
    """Sums up the way, each part by the share that its heading makes it shorter.

    Headings of all parts are taken to be off alike, as a wrong scale makes them: of two whose errors have
    little to do with each other the squares have less still (Cov² at most the product of the variances). So
    the ways add up, not their variances. x, y: m, the sum.
    """

    x: float = 0.0
    y: float = 0.0
    _last: tuple[float, float] = (0.0, 0.0)

    def go(self, x: float, y: float, variance: float) -> None:
        """On to x, y, m, with a heading of that variance, rad²."""
        share = shortened(variance)
        before_x, before_y = self._last
        self.x += share * (x - before_x)
        self.y += share * (y - before_y)
        self._last = x, y

    @property
    def covariance(self) -> Array:
        """(2, 2) m² of x and y beyond what derivatives by the heading make."""
        return np.array([[self.x * self.x, self.x * self.y], [self.x * self.y, self.y * self.y]])
