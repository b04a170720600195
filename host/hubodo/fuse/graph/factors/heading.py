"""A heading from a compass or a two-antenna receiver, with an offset that it keeps for the whole drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import COMPASS, COUNT
from hubodo.fuse.graph.factors.linear import Linear


@dataclass(frozen=True, eq=False)
class HeadingFactors:
    """z = heading + compass + noise, modulo a turn. state: (M,) poses; heading, sigma: (M,) rad."""

    state: NDArray[np.intp]
    heading: Array
    sigma: Array

    def linear(self, poses: Array, constants: Array) -> Linear:
        """About poses (n, 3) and constants (6,)."""
        off = poses[self.state, 2] + constants[COMPASS] - self.heading
        residual = (np.mod(off + np.pi, 2.0 * np.pi) - np.pi) / self.sigma
        by_state = np.zeros((len(off), 1, 3))
        by_constants = np.zeros((len(off), 1, COUNT))
        by_state[:, 0, 2] = by_constants[:, 0, COMPASS] = 1.0 / self.sigma
        return Linear(self.state, residual[:, None], by_state, None, by_constants)

    def row(self, i: int) -> HeadingFactors:
        """Heading i alone, on pose 0."""
        part = slice(i, i + 1)
        return HeadingFactors(np.zeros(1, np.intp), self.heading[part], self.sigma[part])
