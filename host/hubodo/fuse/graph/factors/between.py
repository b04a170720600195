"""Odometry between two successive poses: its steps, compounded and corrected by the constants."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import CURVATURE, N_CONSTANTS, WHEEL_RADIUS, YAW_RATE, YAW_SCALE
from hubodo.fuse.graph.factors.factor import FactorGroup, Flags, LinearisedFactors, find_bridged_runs
from hubodo.fuse.graph.factors.loss import Loss

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class OdometrySteps:
    """S odometry steps that tile n - 1 segments between n poses.

    Attributes
    ----------
    first_step : (n - 1,) number of each segment's first step.
    chord : (S,) complex, m; forward + i left of the heading at the middle of the step.
    mid_heading, mid_time, mid_distance : (S,) heading, s and m from the segment's start to the middle of the
        step, by the odometry.
    totals : (n - 1, 3) the same three for the whole segment.
    covariance : (n - 1, 3, 3) of the segment's forward, left (m) and heading (rad), in axes of its first
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
        """Return the corrected heading at the middle of each step since its segment's start, (S,) rad."""
        return np.asarray(
            (1.0 + constants[YAW_SCALE]) * self.mid_heading
            + constants[YAW_RATE] * self.mid_time
            + constants[CURVATURE] * self.mid_distance
        )

    def correct_displacements(self, constants: Array) -> ComplexArray:
        """Return each corrected step in axes of its segment's first pose, (S,) complex, m."""
        return np.asarray(
            (1.0 + constants[WHEEL_RADIUS]) * self.chord * np.exp(1j * self.correct_headings(constants))
        )

    def correct_turns(self, constants: Array) -> Array:
        """Return the corrected heading change from pose to pose, (n - 1,) rad."""
        corrections = constants[[YAW_SCALE, YAW_RATE, CURVATURE]]
        return np.asarray(self.totals @ (np.array([1.0, 0.0, 0.0]) + corrections))

    def select_segments(self, start: int, end: int) -> OdometrySteps:
        """Return segments start to end - 1."""
        edges = np.append(self.first_step, len(self.chord))
        steps = slice(edges[start], edges[end])
        return OdometrySteps(
            self.first_step[start:end] - edges[start],
            self.chord[steps],
            self.mid_heading[steps],
            self.mid_time[steps],
            self.mid_distance[steps],
            self.totals[start:end],
            self.covariance[start:end],
        )

    def append(self, later: OdometrySteps) -> OdometrySteps:
        """Return these segments and those that follow them."""
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
    """Odometry from pose to pose, with the noise of OdometrySteps.covariance.

    R(h_k)' (p_{k+1} - p_k) = d(constants), h_{k+1} - h_k = turn(constants).

    p_k and h_k are position and heading of pose k. d is the sum of the steps, each scaled by 1 + wheel_radius
    and rotated by (1 + yaw_scale) times the odometry's own angle plus yaw_rate times the time plus curvature
    times the distance since pose k (Shah et al. eq. 16, with the constants estimated). Slip is rare and
    large, so beyond five sigma of a segment its influence is constant.

    Attributes
    ----------
    steps : the odometry.
    whitening : (n - 1, 3, 3), W with W'W the inverse of the covariance.
    """

    steps: OdometrySteps
    whitening: Array
    loss: Loss = field(default=Loss("huber", 25.0), kw_only=True)

    @classmethod
    def from_steps(cls, steps: OdometrySteps) -> BetweenFactors:
        """Return one factor for each segment."""
        return cls(np.arange(len(steps.first_step)), steps, _whitening_matrices(steps.covariance))

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Return whitened residuals and derivatives at poses (n, 3) and constants (N_CONSTANTS,)."""
        steps = self.steps
        displacements = steps.correct_displacements(constants)
        segment_displacement = np.add.reduceat(displacements, steps.first_step)
        displacement_by_heading = 1j * displacements
        pose_difference = np.diff(poses, axis=0)
        heading = poses[:-1, 2]
        cos, sin = np.cos(heading), np.sin(heading)
        forward, left = (
            cos * pose_difference[:, 0] + sin * pose_difference[:, 1],
            cos * pose_difference[:, 1] - sin * pose_difference[:, 0],
        )
        residual = np.column_stack(
            [
                forward - segment_displacement.real,
                left - segment_displacement.imag,
                pose_difference[:, 2] - steps.correct_turns(constants),
            ]
        )

        by_state = np.zeros((len(pose_difference), 3, 3))
        by_state[:, 0, 0] = by_state[:, 1, 1] = -cos
        by_state[:, 0, 1], by_state[:, 1, 0] = -sin, sin
        by_state[:, 0, 2], by_state[:, 1, 2] = left, -forward
        by_next = -by_state
        by_next[:, :, 2] = 0.0
        by_state[:, 2, 2], by_next[:, 2, 2] = -1.0, 1.0

        by_constants = np.zeros((len(pose_difference), 3, N_CONSTANTS))
        derivatives = {
            WHEEL_RADIUS: segment_displacement / (1.0 + constants[WHEEL_RADIUS]),
            YAW_SCALE: np.add.reduceat(displacement_by_heading * steps.mid_heading, steps.first_step),
            YAW_RATE: np.add.reduceat(displacement_by_heading * steps.mid_time, steps.first_step),
            CURVATURE: np.add.reduceat(displacement_by_heading * steps.mid_distance, steps.first_step),
        }
        for constant, value in derivatives.items():
            by_constants[:, 0, constant], by_constants[:, 1, constant] = -value.real, -value.imag
        for column, constant in enumerate((YAW_SCALE, YAW_RATE, CURVATURE)):
            by_constants[:, 2, constant] = -steps.totals[:, column]
        whitening = self.whitening
        return LinearisedFactors(
            self.pose_index,
            (whitening @ residual[:, :, None])[:, :, 0],
            whitening @ by_state,
            whitening @ by_next,
            whitening @ by_constants,
        )

    def describe_outliers(self, is_outlier: Flags, norm: Array, pose_t: Array) -> list[str]:
        """Return warnings for times in which the wheels rolled differently from how the vehicle moved."""
        return [
            f"odometry: between t = {pose_t[first]:.1f} and {pose_t[last + 1]:.1f} s it does not agree "
            "with what was measured from outside; slip or a carried vehicle"
            for first, last in find_bridged_runs(is_outlier)
        ]

    def append(self, later: BetweenFactors, offset: int) -> BetweenFactors:
        """Return these segments and those that follow them; `offset` is the number of these."""
        whiten = np.concatenate([self.whitening, later.whitening])
        return replace(
            self,
            pose_index=np.append(self.pose_index, later.pose_index + offset),
            steps=self.steps.append(later.steps),
            whitening=whiten,
        )

    def _slice_factors(self, first: int, last: int, start: int) -> BetweenFactors:
        return replace(
            self,
            pose_index=self.pose_index[first:last] - start,
            steps=self.steps.select_segments(first, last),
            whitening=self.whitening[first:last],
        )


def _whitening_matrices(covariance: Array) -> Array:
    """Return upper triangular W, (n, 3, 3), with W'W the inverse of each covariance."""
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1))
