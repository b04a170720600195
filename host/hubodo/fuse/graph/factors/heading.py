"""Heading from a compass or a two-antenna receiver, with a constant offset and the deviation by iron."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.constants import (
    COMPASS_OFFSET,
    HARD_IRON_FORWARD,
    HARD_IRON_LEFT,
    N_CONSTANTS,
    SOFT_IRON_DIAGONAL,
    SOFT_IRON_FORWARD,
)
from hubodo.fuse.graph.factors.factor import FactorGroup, LinearisedFactors
from hubodo.fuse.graph.factors.loss import Loss
from hubodo.fuse.graph.odometry_steps import SegmentedOdometry
from hubodo.recording import Table

_MIN_HEADING_SIGMA = 1e-4
"""rad; no compass or antenna pair is more accurate, and a sigma of 0 is a mistake."""
HEADING_LOSS = Loss("bounded", 9.0)
"""Loss of a heading residual: the weight falls beyond three sigma, to zero at six."""
_MIN_SQUARED_FIELD = 1e-2
"""Fraction of the squared horizontal field below which iron cancels it, and a compass has no direction."""


@dataclass(frozen=True, eq=False)
class Headings:
    """Heading samples, each (N,).

    Attributes
    ----------
    t : s on the log's clock.
    heading : rad, anticlockwise from east.
    sigma : rad, or None.
    """

    t: Array
    heading: Array
    sigma: Array | None = None

    @classmethod
    def from_table(cls, table: Table) -> Headings:
        """Return the headings of a recording's table `heading`."""
        return cls(table.t, table["heading"], table.columns.get("sigma"))

    @property
    def pose_times(self) -> Array:
        """Return no times: the poses of the graph, one a second or more, are enough for a compass."""
        return self.t[:0]

    def build_factors(self, odometry: SegmentedOdometry, config: GraphConfig) -> HeadingFactors | None:
        """Return one factor for each pose that has samples near it.

        Samples are moved to the nearest pose by the odometry's own turn. Those of one pose are averaged and
        count as one, since the errors of a compass are correlated for longer than a second.
        """
        pose_t = odometry.pose_t
        in_range = (self.t >= pose_t[0]) & (self.t <= pose_t[-1]) & np.isfinite(self.heading)
        if not in_range.any():
            return None
        t = self.t[in_range]
        next_pose = np.clip(np.searchsorted(pose_t, t), 1, len(pose_t) - 1)
        nearest = next_pose - (t - pose_t[next_pose - 1] < pose_t[next_pose] - t)
        turn_since_pose = odometry.heading_at(t) - odometry.odometry_pose[nearest, 2]
        poses_with_samples, inverse = np.unique(nearest, return_inverse=True)
        phasor_sum = np.zeros(len(poses_with_samples), np.complex128)
        np.add.at(phasor_sum, inverse, np.exp(1j * (self.heading[in_range] - turn_since_pose)))
        sigma = np.full(len(t), np.nan) if self.sigma is None else np.asarray(self.sigma)[in_range]
        sigma = np.where(np.isfinite(sigma) & (sigma > 0.0), sigma, config.heading_sigma)
        min_sigma = np.full(len(poses_with_samples), np.inf)
        np.minimum.at(min_sigma, inverse, sigma)
        return HeadingFactors(
            poses_with_samples.astype(np.intp),
            np.angle(phasor_sum),
            np.maximum(min_sigma, _MIN_HEADING_SIGMA),
        )


@dataclass(frozen=True, eq=False)
class HeadingFactors(FactorGroup):
    """Factors z = offset + arg(exp(i h) + left + i forward - (a - i b) exp(-i h)) + noise, modulo a turn.

    h is the heading of the pose, offset is compass_offset. A compass of a vehicle at heading h reads the
    horizontal field exp(-i h) in axes of the vehicle, plus that of its hard iron, forward and left, plus (a +
    i b) times the conjugate field by its soft iron, a along the vehicle and b along its diagonal (Poisson's
    equations of the compass, in two dimensions). All are fractions of the horizontal field, and constants of
    the drive. Beside foreign iron a compass is off by any angle, so the weight of a factor falls beyond three
    sigma.

    Attributes
    ----------
    heading, sigma : (M,) rad.
    """

    heading: Array
    sigma: Array
    loss: Loss = field(default=HEADING_LOSS, kw_only=True)

    def linearise(self, poses: Array, constants: Array) -> LinearisedFactors:
        """Return whitened residuals and derivatives at poses (n, 3) and constants (N_CONSTANTS,)."""
        direction = np.exp(1j * poses[self.pose_index, 2])
        mirrored = np.conj(direction)
        hard_iron = constants[HARD_IRON_LEFT] + 1j * constants[HARD_IRON_FORWARD]
        soft_iron = constants[SOFT_IRON_FORWARD] - 1j * constants[SOFT_IRON_DIAGONAL]
        reading = direction + hard_iron - soft_iron * mirrored
        inverse = np.conj(reading) / np.maximum(np.abs(reading) ** 2, _MIN_SQUARED_FIELD)
        error = np.angle(reading) + constants[COMPASS_OFFSET] - self.heading
        residual = (np.mod(error + np.pi, 2.0 * np.pi) - np.pi) / self.sigma
        by_state = np.zeros((len(error), 1, 3))
        by_constants = np.zeros((len(error), 1, N_CONSTANTS))
        by_state[:, 0, 2] = ((direction + soft_iron * mirrored) * inverse).real / self.sigma
        by_constants[:, 0, COMPASS_OFFSET] = 1.0 / self.sigma
        by_constants[:, 0, HARD_IRON_LEFT] = inverse.imag / self.sigma
        by_constants[:, 0, HARD_IRON_FORWARD] = inverse.real / self.sigma
        by_constants[:, 0, SOFT_IRON_FORWARD] = -(mirrored * inverse).imag / self.sigma
        by_constants[:, 0, SOFT_IRON_DIAGONAL] = (mirrored * inverse).real / self.sigma
        return LinearisedFactors(self.pose_index, residual[:, None], by_state, None, by_constants)
