"""A heading from a compass or a two-antenna receiver, with an offset that it keeps for the whole drive."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.constants import COMPASS_OFFSET, N_CONSTANTS
from hubodo.fuse.graph.factors.factor import FactorGroup, LinearisedFactors
from hubodo.fuse.graph.factors.loss import Loss
from hubodo.fuse.graph.odometry_steps import SegmentedOdometry

_MIN_HEADING_SIGMA = 1e-4
"""rad; no compass or pair of antennas is better, and a sigma of 0 is a slip."""


@dataclass(frozen=True, eq=False)
class Headings:
    """Headings, each (N,). t: s; heading: rad, anticlockwise from east; sigma: rad or None."""

    t: Array
    heading: Array
    sigma: Array | None = None

    @property
    def pose_times(self) -> Array:
        """None: a compass is read ten times a second, and one pose a second is enough for it."""
        return self.t[:0]

    def build_factors(self, cut: SegmentedOdometry, config: GraphConfig) -> HeadingFactors | None:
        """Headings carried to the nearest pose by the odometry's own turning, one for each pose that has any.

        Readings of one pose are averaged and count as one, for a compass errs alike for longer than a second.
        """
        pose_t = cut.pose_t
        use = (self.t >= pose_t[0]) & (self.t <= pose_t[-1]) & np.isfinite(self.heading)
        if not use.any():
            return None
        t = self.t[use]
        after = np.clip(np.searchsorted(pose_t, t), 1, len(pose_t) - 1)
        nearest = after - (t - pose_t[after - 1] < pose_t[after] - t)
        turned = cut.heading_at(t) - cut.odometry_pose[nearest, 2]
        pose, inverse = np.unique(nearest, return_inverse=True)
        total = np.zeros(len(pose), np.complex128)
        np.add.at(total, inverse, np.exp(1j * (self.heading[use] - turned)))
        own = np.full(len(t), np.nan) if self.sigma is None else np.asarray(self.sigma)[use]
        own = np.where(np.isfinite(own) & (own > 0.0), own, config.heading_sigma)
        least = np.full(len(pose), np.inf)
        np.minimum.at(least, inverse, own)
        return HeadingFactors(pose.astype(np.intp), np.angle(total), np.maximum(least, _MIN_HEADING_SIGMA))


@dataclass(frozen=True, eq=False)
class HeadingFactors(FactorGroup):
    """z = heading + compass_offset + noise, modulo a turn.

    heading, sigma: (M,) rad. A compass beside iron is off by any angle: beyond three sigma its pull fades.
    """

    heading: Array
    sigma: Array
    loss: Loss = field(default=Loss("bounded", 9.0), kw_only=True)

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """About poses (n, 3) and constants (COUNT,)."""
        off = poses[self.pose_index, 2] + constants[COMPASS_OFFSET] - self.heading
        residual = (np.mod(off + np.pi, 2.0 * np.pi) - np.pi) / self.sigma
        by_state = np.zeros((len(off), 1, 3))
        by_constants = np.zeros((len(off), 1, N_CONSTANTS))
        by_state[:, 0, 2] = by_constants[:, 0, COMPASS_OFFSET] = 1.0 / self.sigma
        return LinearisedFactors(self.pose_index, residual[:, None], by_state, None, by_constants)
