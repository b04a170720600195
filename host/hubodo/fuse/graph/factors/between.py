"""What the odometry says of two poses that follow each other: its increments, compounded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import COUNT, CURVE, RATE, SCALE, TURN
from hubodo.fuse.graph.factors.linear import Linear

Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Steps:
    """Odometry steps that tile n - 1 stretches between n poses.

    first: (n - 1,) number of each stretch's first step. way: (S,) complex, m: each step's chord, forward +
    i left of the heading at its middle. turn, after, rolled: (S,) heading, s and m from the stretch's start
    to the middle of the step, as the odometry has them. whole: (n - 1, 3) the same three for the stretch.
    covariance: (n - 1, 3, 3) of the stretch's forward, left (m) and heading (rad), in axes of its first
    pose.
    """

    first: NDArray[np.intp]
    way: Complex
    turn: Array
    after: Array
    rolled: Array
    whole: Array
    covariance: Array

    def angles(self, constants: Array) -> Array:
        """(S,) rad from the stretch's first heading to that at the middle of each step."""
        return np.asarray(
            (1.0 + constants[TURN]) * self.turn
            + constants[RATE] * self.after
            + constants[CURVE] * self.rolled
        )

    def moves(self, constants: Array) -> Complex:
        """(S,) m, each step in axes of the stretch's first pose."""
        return np.asarray((1.0 + constants[SCALE]) * self.way * np.exp(1j * self.angles(constants)))

    def turns(self, constants: Array) -> Array:
        """(n - 1,) rad, heading from pose to pose."""
        return np.asarray(self.whole @ np.array([1.0 + constants[TURN], constants[RATE], constants[CURVE]]))


@dataclass(frozen=True, eq=False)
class BetweenFactors:
    """R(h_k)' (p_{k+1} - p_k) = d(constants), h_{k+1} - h_k = turn(constants), with noise of
    Steps.covariance.

    d is the sum of the steps, each scaled by 1 + scale and turned by (1 + turn) times the odometry's own
    angle, rate times the time and curve times the way since pose k (Shah et al. eq. 16, with the constants
    solved for). whiten: (n - 1, 3, 3), W'W the inverse of the covariance.
    """

    steps: Steps
    whiten: Array

    def linear(self, poses: Array, constants: Array) -> Linear:
        """About poses (n, 3) and constants (6,)."""
        steps = self.steps
        moves = steps.moves(constants)
        moved = np.add.reduceat(moves, steps.first)
        spun = 1j * moves
        gap = np.diff(poses, axis=0)
        heading = poses[:-1, 2]
        cos, sin = np.cos(heading), np.sin(heading)
        forward, left = cos * gap[:, 0] + sin * gap[:, 1], cos * gap[:, 1] - sin * gap[:, 0]
        residual = np.column_stack(
            [forward - moved.real, left - moved.imag, gap[:, 2] - steps.turns(constants)]
        )

        by_state = np.zeros((len(gap), 3, 3))
        by_state[:, 0, 0] = by_state[:, 1, 1] = -cos
        by_state[:, 0, 1], by_state[:, 1, 0] = -sin, sin
        by_state[:, 0, 2], by_state[:, 1, 2] = left, -forward
        by_next = -by_state
        by_next[:, :, 2] = 0.0
        by_state[:, 2, 2], by_next[:, 2, 2] = -1.0, 1.0

        by_constants = np.zeros((len(gap), 3, COUNT))
        derivatives = {
            SCALE: moved / (1.0 + constants[SCALE]),
            TURN: np.add.reduceat(spun * steps.turn, steps.first),
            RATE: np.add.reduceat(spun * steps.after, steps.first),
            CURVE: np.add.reduceat(spun * steps.rolled, steps.first),
        }
        for constant, value in derivatives.items():
            by_constants[:, 0, constant], by_constants[:, 1, constant] = -value.real, -value.imag
        for column, constant in enumerate((TURN, RATE, CURVE)):
            by_constants[:, 2, constant] = -steps.whole[:, column]
        w = self.whiten
        return Linear(
            np.arange(len(gap)),
            (w @ residual[:, :, None])[:, :, 0],
            w @ by_state,
            w @ by_next,
            w @ by_constants,
        )

    def row(self, k: int) -> BetweenFactors:
        """Stretch k alone, between poses 0 and 1."""
        s = self.steps
        begin = int(s.first[k])
        end = int(s.first[k + 1]) if k + 1 < len(s.first) else len(s.way)
        part = slice(begin, end)
        steps = Steps(
            np.zeros(1, np.intp),
            s.way[part],
            s.turn[part],
            s.after[part],
            s.rolled[part],
            s.whole[k : k + 1],
            s.covariance[k : k + 1],
        )
        return BetweenFactors(steps, self.whiten[k : k + 1])


def whitening(covariance: Array) -> Array:
    """(n, 3, 3) upper triangular W with W'W the inverse of each covariance."""
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1))
