"""GNSS fixes: the position of the antenna, at a time stamp that may be late."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import GNSS_DELAY, N_CONSTANTS
from hubodo.fuse.graph.factors.factor import FactorGroup, Flags, LinearisedFactors, find_bridged_runs
from hubodo.fuse.graph.factors.loss import Loss


@dataclass(frozen=True, eq=False)
class PositionFactors(FactorGroup):
    """Factors z = p + R(heading) (antenna + gnss_delay velocity) + noise.

    p and heading are the pose, gnss_delay is a constant of the drive. Multipath puts a fix anywhere, so the
    weight of a factor falls beyond 3.5 sigma.

    Attributes
    ----------
    position : (M, 2) east and north, m; the measured z.
    sigma : (M,) m, of each direction.
    velocity : (M, 2) m/s of the body in its own axes.
    antenna : m forward and left of the body origin.
    """

    position: Array
    sigma: Array
    velocity: Array
    antenna: tuple[float, float] = (0.0, 0.0)
    loss: Loss = field(default=Loss("bounded", 12.0), kw_only=True)

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Return whitened residuals and derivatives at poses (n, 3) and constants (N_CONSTANTS,)."""
        pose = poses[self.pose_index]
        cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        vx, vy = self.velocity.T
        ax, ay = self.antenna[0] + constants[GNSS_DELAY] * vx, self.antenna[1] + constants[GNSS_DELAY] * vy
        east, north = cos * ax - sin * ay, sin * ax + cos * ay
        inverse_sigma = 1.0 / self.sigma
        residual = (pose[:, :2] + np.column_stack([east, north]) - self.position) * inverse_sigma[:, None]
        by_state = np.zeros((len(pose), 2, 3))
        by_state[:, 0, 0] = by_state[:, 1, 1] = inverse_sigma
        by_state[:, 0, 2], by_state[:, 1, 2] = -north * inverse_sigma, east * inverse_sigma
        by_constants = np.zeros((len(pose), 2, N_CONSTANTS))
        by_constants[:, 0, GNSS_DELAY] = (cos * vx - sin * vy) * inverse_sigma
        by_constants[:, 1, GNSS_DELAY] = (sin * vx + cos * vy) * inverse_sigma
        return LinearisedFactors(self.pose_index, residual, by_state, None, by_constants)

    def describe_outliers(self, is_outlier: Flags, norm: Array, pose_t: Array) -> list[str]:
        """Return warnings for runs of fixes that are off, and for a single fix."""
        t, distance = pose_t[self.pose_index], norm * self.sigma
        warnings = []
        for first, last in find_bridged_runs(is_outlier):
            count = np.count_nonzero(is_outlier[first : last + 1])
            warnings.append(
                f"gnss: {count} fixes from t = {t[first]:.1f} to {t[last]:.1f} s are off "
                f"by up to {distance[first : last + 1].max():.1f} m; they have little or no weight"
            )
        if len(is_outlier) == 1:
            warnings.append(
                "gnss: one fix only: it determines the position of the track, but not its direction"
            )
        return warnings
