"""What is known of a pose and the constants without measuring: a vague start, or what a window forgot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import FactorGroup, LinearisedFactors

_MIN_CONSTANT_SIGMA = 1e-9
"""Least sigma of a constant: what is said to be known exactly is held, and the equations stay regular."""


@dataclass(frozen=True, eq=False)
class PosePriorFactors(FactorGroup):
    """Priors of poses, x, y in m and heading in rad: mean and 1 sigma, (M, 3)."""

    mean: Array
    sigma: Array

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Rows of three, on no constant."""
        residual = (poses[self.pose_index] - self.mean) / self.sigma
        by_state = np.eye(3) / self.sigma[:, None, :]
        return LinearisedFactors(
            self.pose_index, residual, by_state, None, np.zeros((len(residual), 3, N_CONSTANTS))
        )


@dataclass(frozen=True, eq=False)
class ConstantsPriorFactors(FactorGroup):
    """Priors of the constants: mean and 1 sigma, (M, COUNT); a sigma of 0 holds a constant at its mean.

    Kept with a pose of the chain, but on none.
    """

    mean: Array
    sigma: Array

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Rows of COUNT, on no pose."""
        share = 1.0 / np.maximum(self.sigma, _MIN_CONSTANT_SIGMA)
        by_constants = np.eye(N_CONSTANTS) * share[:, None, :]
        nothing = np.zeros((len(share), N_CONSTANTS, 3))
        return LinearisedFactors(
            self.pose_index, (constants - self.mean) * share, nothing, None, by_constants
        )


@dataclass(frozen=True, eq=False)
class MarginalPriorFactors(FactorGroup):
    """What measurements that are no longer kept said of a pose and of the constants, together.

    A Gaussian in square-root form, residual = offset + root ((pose, constants) - about).

    root: (M, 3 + COUNT, 3 + COUNT), root'root the information with its cross terms; offset, about:
    (M, 3 + COUNT).
    """

    sqrt_information: Array
    offset: Array
    linearisation_point: Array

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Rows of 3 + COUNT."""
        at = np.column_stack([poses[self.pose_index], np.tile(constants, (len(self.pose_index), 1))])
        residual = (
            self.offset + (self.sqrt_information @ (at - self.linearisation_point)[:, :, None])[:, :, 0]
        )
        return LinearisedFactors(
            self.pose_index, residual, self.sqrt_information[:, :, :3], None, self.sqrt_information[:, :, 3:]
        )
