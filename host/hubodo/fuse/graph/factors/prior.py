"""What is known of a pose and the constants without measuring: a vague start, or what a window forgot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import COUNT
from hubodo.fuse.graph.factors.factor import Factor, Linear

_FIRMEST = 1e-9
"""Least sigma of a constant: what is said to be known exactly is held, and the equations stay regular."""


@dataclass(frozen=True, eq=False)
class StartFactor(Factor):
    """Priors of poses, x, y in m and heading in rad: mean and 1 sigma, (M, 3)."""

    mean: Array
    sigma: Array

    def linear(self, poses: Array, constants: Array) -> Linear:
        """Rows of three, on no constant."""
        residual = (poses[self.state] - self.mean) / self.sigma
        by_state = np.eye(3) / self.sigma[:, None, :]
        return Linear(self.state, residual, by_state, None, np.zeros((len(residual), 3, COUNT)))


@dataclass(frozen=True, eq=False)
class ConstantsFactor(Factor):
    """Priors of the constants: mean and 1 sigma, (M, COUNT); a sigma of 0 holds a constant at its mean.

    Kept with a pose of the chain, but on none.
    """

    mean: Array
    sigma: Array

    def linear(self, poses: Array, constants: Array) -> Linear:
        """Rows of COUNT, on no pose."""
        share = 1.0 / np.maximum(self.sigma, _FIRMEST)
        by_constants = np.eye(COUNT) * share[:, None, :]
        nothing = np.zeros((len(share), COUNT, 3))
        return Linear(self.state, (constants - self.mean) * share, nothing, None, by_constants)


@dataclass(frozen=True, eq=False)
class ForgottenFactor(Factor):
    """What measurements that are no longer kept said of a pose and of the constants, together.

    A Gaussian in square-root form, residual = offset + root ((pose, constants) - about).

    root: (M, 3 + COUNT, 3 + COUNT), root'root the information with its cross terms; offset, about:
    (M, 3 + COUNT).
    """

    root: Array
    offset: Array
    about: Array

    def linear(self, poses: Array, constants: Array) -> Linear:
        """Rows of 3 + COUNT."""
        at = np.column_stack([poses[self.state], np.tile(constants, (len(self.state), 1))])
        residual = self.offset + (self.root @ (at - self.about)[:, :, None])[:, :, 0]
        return Linear(self.state, residual, self.root[:, :, :3], None, self.root[:, :, 3:])
