"""Priors of poses and constants, and the prior that marginalised measurements leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import FactorGroup, LinearisedFactors

_MIN_CONSTANT_SIGMA = 1e-9
"""Minimum sigma of a constant: one that is known exactly is held, and the equations stay regular."""


@dataclass(frozen=True, eq=False)
class PosePriorFactors(FactorGroup):
    """Priors of poses, x, y in m and heading in rad: mean and 1 sigma, (M, 3) each."""

    mean: Array
    sigma: Array

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Return three rows for each factor, without derivatives by constants."""
        residual = (poses[self.pose_index] - self.mean) / self.sigma
        by_state = np.eye(3) / self.sigma[:, None, :]
        return LinearisedFactors(
            self.pose_index, residual, by_state, None, np.zeros((len(residual), 3, N_CONSTANTS))
        )


@dataclass(frozen=True, eq=False)
class ConstantsPriorFactors(FactorGroup):
    """Priors of the constants, mean and 1 sigma, (M, N_CONSTANTS) each.

    A sigma of 0 holds a constant at its mean. The priors are stored with a pose of the chain, but do not
    depend on it.
    """

    mean: Array
    sigma: Array

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Return N_CONSTANTS rows for each factor, without derivatives by poses."""
        inverse_sigma = 1.0 / np.maximum(self.sigma, _MIN_CONSTANT_SIGMA)
        by_constants = np.eye(N_CONSTANTS) * inverse_sigma[:, None, :]
        no_pose_jacobian = np.zeros((len(inverse_sigma), N_CONSTANTS, 3))
        return LinearisedFactors(
            self.pose_index, (constants - self.mean) * inverse_sigma, no_pose_jacobian, None, by_constants
        )


@dataclass(frozen=True, eq=False)
class MarginalPriorFactors(FactorGroup):
    """Joint prior of a pose and the constants that marginalised measurements leave.

    A Gaussian in square-root form: residual = offset + A ((pose, constants) - linearisation_point).

    Attributes
    ----------
    sqrt_information : (M, 3 + N_CONSTANTS, 3 + N_CONSTANTS), A; A'A is the information with its cross terms.
    offset, linearisation_point : (M, 3 + N_CONSTANTS).
    """

    sqrt_information: Array
    offset: Array
    linearisation_point: Array

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Return 3 + N_CONSTANTS rows for each factor."""
        values = np.column_stack([poses[self.pose_index], np.tile(constants, (len(self.pose_index), 1))])
        residual = (
            self.offset + (self.sqrt_information @ (values - self.linearisation_point)[:, :, None])[:, :, 0]
        )
        return LinearisedFactors(
            self.pose_index, residual, self.sqrt_information[:, :, :3], None, self.sqrt_information[:, :, 3:]
        )
