"""What the odometry says of two poses that follow each other: its increments, compounded."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import COUNT, CURVATURE, WHEEL_RADIUS, YAW_RATE, YAW_SCALE
from hubodo.fuse.graph.factors.factor import Factor, Flags, Linear, stretches
from hubodo.fuse.graph.factors.loss import Loss

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
            (1.0 + constants[YAW_SCALE]) * self.turn
            + constants[YAW_RATE] * self.after
            + constants[CURVATURE] * self.rolled
        )

    def moves(self, constants: Array) -> Complex:
        """(S,) m, each step in axes of the stretch's first pose."""
        return np.asarray((1.0 + constants[WHEEL_RADIUS]) * self.way * np.exp(1j * self.angles(constants)))

    def turns(self, constants: Array) -> Array:
        """(n - 1,) rad, heading from pose to pose."""
        lacks = constants[[YAW_SCALE, YAW_RATE, CURVATURE]]
        return np.asarray(self.whole @ (np.array([1.0, 0.0, 0.0]) + lacks))

    def part(self, begin: int, end: int) -> Steps:
        """Stretches begin to end - 1."""
        edges = np.append(self.first, len(self.way))
        own = slice(edges[begin], edges[end])
        return Steps(
            self.first[begin:end] - edges[begin],
            self.way[own],
            self.turn[own],
            self.after[own],
            self.rolled[own],
            self.whole[begin:end],
            self.covariance[begin:end],
        )

    def joined(self, later: Steps) -> Steps:
        """These stretches and those that follow them."""
        return Steps(
            np.append(self.first, later.first + len(self.way)),
            np.append(self.way, later.way),
            np.append(self.turn, later.turn),
            np.append(self.after, later.after),
            np.append(self.rolled, later.rolled),
            np.concatenate([self.whole, later.whole]),
            np.concatenate([self.covariance, later.covariance]),
        )


@dataclass(frozen=True, eq=False)
class BetweenFactors(Factor):
    """The odometry from pose to pose, with noise of Steps.covariance.

    R(h_k)' (p_{k+1} - p_k) = d(constants), h_{k+1} - h_k = turn(constants).

    d is the sum of the steps, each scaled by 1 + wheel_radius and turned by (1 + yaw_scale) times the
    odometry's own angle, yaw_rate times the time and curvature times the way since pose k (Shah et al. eq.
    16, with the constants solved for). whiten: (n - 1, 3, 3), W'W the inverse of the covariance. Slip is rare
    and large: beyond five sigma of a stretch its pull grows no more.
    """

    steps: Steps
    whiten: Array
    loss: Loss = field(default=Loss("huber", 25.0), kw_only=True)

    @classmethod
    def of(cls, steps: Steps) -> BetweenFactors:
        """One factor for each stretch."""
        return cls(np.arange(len(steps.first)), steps, _whitening(steps.covariance))

    def linear(self, poses: Array, constants: Array) -> Linear:
        """About poses (n, 3) and constants (COUNT,)."""
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
            WHEEL_RADIUS: moved / (1.0 + constants[WHEEL_RADIUS]),
            YAW_SCALE: np.add.reduceat(spun * steps.turn, steps.first),
            YAW_RATE: np.add.reduceat(spun * steps.after, steps.first),
            CURVATURE: np.add.reduceat(spun * steps.rolled, steps.first),
        }
        for constant, value in derivatives.items():
            by_constants[:, 0, constant], by_constants[:, 1, constant] = -value.real, -value.imag
        for column, constant in enumerate((YAW_SCALE, YAW_RATE, CURVATURE)):
            by_constants[:, 2, constant] = -steps.whole[:, column]
        w = self.whiten
        return Linear(
            self.state,
            (w @ residual[:, :, None])[:, :, 0],
            w @ by_state,
            w @ by_next,
            w @ by_constants,
        )

    def doubts(self, out: Flags, norm: Array, state_t: Array) -> list[str]:
        """Where the wheels rolled other than the vehicle moved."""
        return [
            f"odometry: between t = {state_t[first]:.1f} and {state_t[last + 1]:.1f} s it does not agree "
            "with what was measured from outside; slip or a carried vehicle"
            for first, last in stretches(out)
        ]

    def joined(self, later: BetweenFactors, by: int) -> BetweenFactors:
        """These and the stretches that follow them; `by` is their number."""
        whiten = np.concatenate([self.whiten, later.whiten])
        return replace(
            self,
            state=np.append(self.state, later.state + by),
            steps=self.steps.joined(later.steps),
            whiten=whiten,
        )

    def _cut(self, first: int, last: int, begin: int) -> BetweenFactors:
        return replace(
            self,
            state=self.state[first:last] - begin,
            steps=self.steps.part(first, last),
            whiten=self.whiten[first:last],
        )


def _whitening(covariance: Array) -> Array:
    """(n, 3, 3) upper triangular W with W'W the inverse of each covariance."""
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1))
