"""What the odometry says of two poses that follow each other: its increments, compounded."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import CURVATURE, N_CONSTANTS, WHEEL_RADIUS, YAW_RATE, YAW_SCALE
from hubodo.fuse.graph.factors.factor import FactorGroup, Flags, LinearisedFactors, find_runs
from hubodo.fuse.graph.factors.loss import Loss

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class OdometrySteps:
    """Odometry steps that tile n - 1 stretches between n poses.

    first: (n - 1,) number of each stretch's first step. way: (S,) complex, m: each step's chord, forward +
    i left of the heading at its middle. turn, after, rolled: (S,) heading, s and m from the stretch's start
    to the middle of the step, as the odometry has them. whole: (n - 1, 3) the same three for the stretch.
    covariance: (n - 1, 3, 3) of the stretch's forward, left (m) and heading (rad), in axes of its first
    pose.
    """

    first_step: NDArray[np.intp]
    chord: ComplexArray
    mid_heading: Array
    mid_time: Array
    mid_distance: Array
    totals: Array
    covariance: Array

    def correct_headings(self, constants: Array) -> Array:
        """(S,) rad from the stretch's first heading to that at the middle of each step."""
        return np.asarray(
            (1.0 + constants[YAW_SCALE]) * self.mid_heading
            + constants[YAW_RATE] * self.mid_time
            + constants[CURVATURE] * self.mid_distance
        )

    def correct_displacements(self, constants: Array) -> ComplexArray:
        """(S,) m, each step in axes of the stretch's first pose."""
        return np.asarray(
            (1.0 + constants[WHEEL_RADIUS]) * self.chord * np.exp(1j * self.correct_headings(constants))
        )

    def correct_turns(self, constants: Array) -> Array:
        """(n - 1,) rad, heading from pose to pose."""
        lacks = constants[[YAW_SCALE, YAW_RATE, CURVATURE]]
        return np.asarray(self.totals @ (np.array([1.0, 0.0, 0.0]) + lacks))

    def select_segments(self, begin: int, end: int) -> OdometrySteps:
        """Stretches begin to end - 1."""
        edges = np.append(self.first_step, len(self.chord))
        own = slice(edges[begin], edges[end])
        return OdometrySteps(
            self.first_step[begin:end] - edges[begin],
            self.chord[own],
            self.mid_heading[own],
            self.mid_time[own],
            self.mid_distance[own],
            self.totals[begin:end],
            self.covariance[begin:end],
        )

    def append(self, later: OdometrySteps) -> OdometrySteps:
        """These stretches and those that follow them."""
        return OdometrySteps(
            np.append(self.first_step, later.first_step + len(self.chord)),
            np.append(self.chord, later.chord),
            np.append(self.mid_heading, later.mid_heading),
            np.append(self.mid_time, later.mid_time),
            np.append(self.mid_distance, later.mid_distance),
            np.concatenate([self.totals, later.totals]),
            np.concatenate([self.covariance, later.covariance]),
        )


@dataclass(frozen=True, eq=False)
class BetweenFactors(FactorGroup):
    """The odometry from pose to pose, with noise of Steps.covariance.

    R(h_k)' (p_{k+1} - p_k) = d(constants), h_{k+1} - h_k = turn(constants).

    d is the sum of the steps, each scaled by 1 + wheel_radius and turned by (1 + yaw_scale) times the
    odometry's own angle, yaw_rate times the time and curvature times the way since pose k (Shah et al. eq.
    16, with the constants solved for). whiten: (n - 1, 3, 3), W'W the inverse of the covariance. Slip is rare
    and large: beyond five sigma of a stretch its pull grows no more.
    """

    steps: OdometrySteps
    whitening: Array
    loss: Loss = field(default=Loss("huber", 25.0), kw_only=True)

    @classmethod
    def from_steps(cls, steps: OdometrySteps) -> BetweenFactors:
        """One factor for each stretch."""
        return cls(np.arange(len(steps.first_step)), steps, _whitening_matrices(steps.covariance))

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """About poses (n, 3) and constants (COUNT,)."""
        steps = self.steps
        moves = steps.correct_displacements(constants)
        moved = np.add.reduceat(moves, steps.first_step)
        spun = 1j * moves
        gap = np.diff(poses, axis=0)
        heading = poses[:-1, 2]
        cos, sin = np.cos(heading), np.sin(heading)
        forward, left = cos * gap[:, 0] + sin * gap[:, 1], cos * gap[:, 1] - sin * gap[:, 0]
        residual = np.column_stack(
            [forward - moved.real, left - moved.imag, gap[:, 2] - steps.correct_turns(constants)]
        )

        by_state = np.zeros((len(gap), 3, 3))
        by_state[:, 0, 0] = by_state[:, 1, 1] = -cos
        by_state[:, 0, 1], by_state[:, 1, 0] = -sin, sin
        by_state[:, 0, 2], by_state[:, 1, 2] = left, -forward
        by_next = -by_state
        by_next[:, :, 2] = 0.0
        by_state[:, 2, 2], by_next[:, 2, 2] = -1.0, 1.0

        by_constants = np.zeros((len(gap), 3, N_CONSTANTS))
        derivatives = {
            WHEEL_RADIUS: moved / (1.0 + constants[WHEEL_RADIUS]),
            YAW_SCALE: np.add.reduceat(spun * steps.mid_heading, steps.first_step),
            YAW_RATE: np.add.reduceat(spun * steps.mid_time, steps.first_step),
            CURVATURE: np.add.reduceat(spun * steps.mid_distance, steps.first_step),
        }
        for constant, value in derivatives.items():
            by_constants[:, 0, constant], by_constants[:, 1, constant] = -value.real, -value.imag
        for column, constant in enumerate((YAW_SCALE, YAW_RATE, CURVATURE)):
            by_constants[:, 2, constant] = -steps.totals[:, column]
        w = self.whitening
        return LinearisedFactors(
            self.pose_index,
            (w @ residual[:, :, None])[:, :, 0],
            w @ by_state,
            w @ by_next,
            w @ by_constants,
        )

    def describe_outliers(self, out: Flags, norm: Array, pose_t: Array) -> list[str]:
        """Where the wheels rolled other than the vehicle moved."""
        return [
            f"odometry: between t = {pose_t[first]:.1f} and {pose_t[last + 1]:.1f} s it does not agree "
            "with what was measured from outside; slip or a carried vehicle"
            for first, last in find_runs(out)
        ]

    def append(self, later: BetweenFactors, by: int) -> BetweenFactors:
        """These and the stretches that follow them; `by` is their number."""
        whiten = np.concatenate([self.whitening, later.whitening])
        return replace(
            self,
            pose_index=np.append(self.pose_index, later.pose_index + by),
            steps=self.steps.append(later.steps),
            whitening=whiten,
        )

    def _slice_factors(self, first: int, last: int, begin: int) -> BetweenFactors:
        return replace(
            self,
            pose_index=self.pose_index[first:last] - begin,
            steps=self.steps.select_segments(first, last),
            whitening=self.whitening[first:last],
        )


def _whitening_matrices(covariance: Array) -> Array:
    """(n, 3, 3) upper triangular W with W'W the inverse of each covariance."""
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1))
