"""Gates of known position north of the origin: an example of a new kind of factor, as its recipe asks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import FactorGroup, Flags, LinearisedFactors
from hubodo.fuse.graph.odometry_steps import SegmentedOdometry
from hubodo.recording import Table

GATE_SIGMA = 0.02  # m, half the width of a gate


@dataclass(frozen=True, eq=False)
class Gates:
    """Passages of gates, each (N,): t in s, north in m; where east of the origin is unknown."""

    t: Array
    north: Array

    @classmethod
    def from_table(cls, table: Table) -> Gates:
        """Return the gates of a recording's table `gate`."""
        return cls(table.t, table["north"])

    @property
    def pose_times(self) -> Array:
        """Return the time of each passage: the graph has a pose there."""
        return self.t

    def build_factors(self, odometry: SegmentedOdometry, config: GraphConfig) -> GateFactors | None:
        """Return one factor for each gate passed within the odometry."""
        in_range = (self.t >= odometry.pose_t[0]) & (self.t <= odometry.pose_t[-1])
        if not in_range.any():
            return None
        pose_index = np.searchsorted(odometry.pose_t, self.t[in_range])
        return GateFactors(pose_index, self.north[in_range], np.full(len(pose_index), GATE_SIGMA))


@dataclass(frozen=True, eq=False)
class GateFactors(FactorGroup):
    """Factors north = y + noise; north, sigma: (M,) m."""

    north: Array
    sigma: Array

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Return whitened residuals and derivatives."""
        residual = ((poses[self.pose_index, 1] - self.north) / self.sigma)[:, None]
        pose_jacobian = np.zeros((len(residual), 1, 3))
        pose_jacobian[:, 0, 1] = 1.0 / self.sigma
        constants_jacobian = np.zeros((len(residual), 1, N_CONSTANTS))
        return LinearisedFactors(self.pose_index, residual, pose_jacobian, None, constants_jacobian)

    def describe_outliers(self, is_outlier: Flags, norm: Array, pose_t: Array) -> list[str]:
        """Return the number of passed gates."""
        return [f"gate: passed {len(norm)} times"]
