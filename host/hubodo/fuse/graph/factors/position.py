"""A GNSS fix: where the antenna is, at a time stamp that may be off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import COUNT, DELAY
from hubodo.fuse.graph.factors.linear import Linear


@dataclass(frozen=True, eq=False)
class PositionFactors:
    """z = p + R(heading) (antenna + delay velocity) + noise.

    state: (M,) poses. place: (M, 2) east and north, m. sigma: (M,) m of each direction. velocity: (M, 2) m/s
    of the body in its own axes. antenna: forward and left of the body origin, m.
    """

    state: NDArray[np.intp]
    place: Array
    sigma: Array
    velocity: Array
    antenna: tuple[float, float] = (0.0, 0.0)

    def linear(self, poses: Array, constants: Array) -> Linear:
        """About poses (n, 3) and constants (6,)."""
        at = poses[self.state]
        cos, sin = np.cos(at[:, 2]), np.sin(at[:, 2])
        vx, vy = self.velocity.T
        ax, ay = self.antenna[0] + constants[DELAY] * vx, self.antenna[1] + constants[DELAY] * vy
        east, north = cos * ax - sin * ay, sin * ax + cos * ay
        share = 1.0 / self.sigma
        residual = (at[:, :2] + np.column_stack([east, north]) - self.place) * share[:, None]
        by_state = np.zeros((len(at), 2, 3))
        by_state[:, 0, 0] = by_state[:, 1, 1] = share
        by_state[:, 0, 2], by_state[:, 1, 2] = -north * share, east * share
        by_constants = np.zeros((len(at), 2, COUNT))
        by_constants[:, 0, DELAY] = (cos * vx - sin * vy) * share
        by_constants[:, 1, DELAY] = (sin * vx + cos * vy) * share
        return Linear(self.state, residual, by_state, None, by_constants)

    def row(self, i: int) -> PositionFactors:
        """Fix i alone, on pose 0."""
        part = slice(i, i + 1)
        zero = np.zeros(1, np.intp)
        return PositionFactors(zero, self.place[part], self.sigma[part], self.velocity[part], self.antenna)
