"""What is known of a pose without measurement: a start, however vague, or what a sliding window forgot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import COUNT
from hubodo.fuse.graph.factors.linear import Linear


@dataclass(frozen=True, eq=False)
class StartFactor:
    """Prior of pose number `state`: x, y in m and heading in rad, (3,) mean and 1 sigma."""

    state: int
    mean: Array
    sigma: Array

    def linear(self, poses: Array) -> Linear:
        """One row of three."""
        share = 1.0 / self.sigma
        residual = ((poses[self.state] - self.mean) * share)[None]
        state = np.array([self.state], np.intp)
        return Linear(state, residual, np.diag(share)[None], None, np.zeros((1, 3, COUNT)))
