"""Position variance from heading errors beyond first order: paths with a wrong heading get shorter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array


def relative_length_loss(variance: float) -> float:
    """Return the rms relative shortening of a path whose heading error d has a variance, rad².

    √E(1 - cos d)² for normal d; √(3/4) times the variance if that is small. First-order propagation only
    moves the path sideways.
    """
    mean_square = 1.5 - 2.0 * math.exp(-0.5 * variance) + 0.5 * math.exp(-2.0 * variance)
    # Rounding makes the square negative below a microradian.
    return math.sqrt(max(mean_square, 0.0))


@dataclass
class HeadingErrorInflation:
    """Sum of path segments, each scaled by the relative shortening of its heading error.

    Heading errors of all segments are assumed to be fully correlated, as from a gyro scale error, which is
    an upper bound (Cov² is at most the product of the variances). So displacements add up, not their
    variances. x, y: m, the sum.
    """

    x: float = 0.0
    y: float = 0.0
    _last_position: tuple[float, float] = (0.0, 0.0)

    def advance(self, x: float, y: float, variance: float) -> None:
        """Add the segment up to x, y (m) with a heading variance, rad²."""
        relative = relative_length_loss(variance)
        before_x, before_y = self._last_position
        self.x += relative * (x - before_x)
        self.y += relative * (y - before_y)
        self._last_position = x, y

    @property
    def covariance(self) -> Array:
        """Return the second-order covariance of x and y, (2, 2) m²."""
        return np.array([[self.x * self.x, self.x * self.y], [self.x * self.y, self.y * self.y]])
