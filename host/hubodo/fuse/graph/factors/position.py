"""A GNSS fix: where the antenna is, at a time stamp that may be off."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.constants import GNSS_DELAY, N_CONSTANTS
from hubodo.fuse.graph.factors.factor import FactorGroup, Flags, LinearisedFactors, find_runs
from hubodo.fuse.graph.factors.loss import Loss


@dataclass(frozen=True, eq=False)
class PositionFactors(FactorGroup):
    """z = p + R(heading) (antenna + gnss_delay velocity) + noise.

    place: (M, 2) east and north, m. sigma: (M,) m of each direction. velocity: (M, 2) m/s of the body in its
    own axes. antenna: forward and left of the body origin, m. Reflections put a fix anywhere: beyond 3.5
    sigma its pull fades.
    """

    position: Array
    sigma: Array
    velocity: Array
    antenna: tuple[float, float] = (0.0, 0.0)
    loss: Loss = field(default=Loss("bounded", 12.0), kw_only=True)

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """About poses (n, 3) and constants (COUNT,)."""
        at = poses[self.pose_index]
        cos, sin = np.cos(at[:, 2]), np.sin(at[:, 2])
        vx, vy = self.velocity.T
        ax, ay = self.antenna[0] + constants[GNSS_DELAY] * vx, self.antenna[1] + constants[GNSS_DELAY] * vy
        east, north = cos * ax - sin * ay, sin * ax + cos * ay
        share = 1.0 / self.sigma
        residual = (at[:, :2] + np.column_stack([east, north]) - self.position) * share[:, None]
        by_state = np.zeros((len(at), 2, 3))
        by_state[:, 0, 0] = by_state[:, 1, 1] = share
        by_state[:, 0, 2], by_state[:, 1, 2] = -north * share, east * share
        by_constants = np.zeros((len(at), 2, N_CONSTANTS))
        by_constants[:, 0, GNSS_DELAY] = (cos * vx - sin * vy) * share
        by_constants[:, 1, GNSS_DELAY] = (sin * vx + cos * vy) * share
        return LinearisedFactors(self.pose_index, residual, by_state, None, by_constants)

    def describe_outliers(self, out: Flags, norm: Array, pose_t: Array) -> list[str]:
        """Fixes that jumped, and one that is alone."""
        t, far = pose_t[self.pose_index], norm * self.sigma
        said = []
        for first, last in find_runs(out):
            count = np.count_nonzero(out[first : last + 1])
            said.append(
                f"gnss: {count} fixes from t = {t[first]:.1f} to {t[last]:.1f} s are off "
                f"by up to {far[first : last + 1].max():.1f} m; they count little or not at all"
            )
        if len(out) == 1:
            said.append("gnss: one fix only: it places the track, but does not tell its direction")
        return said
