"""Constant errors of a drive that the graph estimates together with the poses, and their priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from hubodo.arrays import Array


@dataclass(frozen=True, slots=True)
class ConstantSigmas:
    """Prior 1 sigma of each constant, in the order of their numbers.

    Each has mean zero and is a correction of the odometry. The defaults are those of headings from gyros on
    wheels.

    Attributes
    ----------
    wheel_radius : fraction of the distance; the effect of that name, common to both wheels.
    yaw_scale : fraction of the heading's increments: minus gyro_scale_factor across the axle, 1 % by data
        sheets of MEMS gyros, or minus track_width where the heading comes from the difference of the wheels.
    yaw_rate : rad/s, minus gyro_bias about the vertical: 40 deg/h, the residual of a filter after a
        standstill.
    curvature : rad/m, difference of the wheels' radii over radius and track: 0.015 % on half a metre.
    gnss_delay : s by which GNSS time stamps precede the time of the position: a quarter of an epoch at 5 Hz.
    compass_offset : rad by which headings read too much: a compass mounted by eye, 2 deg.
    compass_hard_iron_forward, compass_hard_iron_left : field of the vehicle's iron at the compass, as a
        fraction of the horizontal field of the Earth; 0 until `compass.py` has assessed the headings.
    compass_soft_iron_forward, compass_soft_iron_diagonal : half the difference of the gains of two
        perpendicular directions, forward and left, or their diagonals, as a fraction; likewise 0.
    """

    wheel_radius: float = 0.025
    yaw_scale: float = 0.01
    yaw_rate: float = 2e-4
    curvature: float = 3e-4
    gnss_delay: float = 0.05
    compass_offset: float = 0.03
    compass_hard_iron_forward: float = 0.0
    compass_hard_iron_left: float = 0.0
    compass_soft_iron_forward: float = 0.0
    compass_soft_iron_diagonal: float = 0.0

    def to_array(self) -> Array:
        """Return the sigmas as (N_CONSTANTS,), in the order of the indices below."""
        return np.array([getattr(self, name) for name in CONSTANT_NAMES])


CONSTANT_NAMES: tuple[str, ...] = tuple(item.name for item in fields(ConstantSigmas))
N_CONSTANTS = len(CONSTANT_NAMES)
WHEEL_RADIUS, YAW_SCALE, YAW_RATE, CURVATURE, GNSS_DELAY, COMPASS_OFFSET = range(6)
HARD_IRON_FORWARD, HARD_IRON_LEFT, SOFT_IRON_FORWARD, SOFT_IRON_DIAGONAL = range(6, N_CONSTANTS)
COMPASS_IRON = slice(HARD_IRON_FORWARD, N_CONSTANTS)
"""The constants of the iron near a compass."""

_MIN_SIGMAS = ConstantSigmas(wheel_radius=5e-4, yaw_scale=1e-3, yaw_rate=5e-5, curvature=1e-5)
"""Change of tyres and road from hour to hour, whatever was measured before.

Tyre pressure with 10 degrees of warming, a gyro's scale with its temperature, 10 deg/h of bias. The heading
of the wheel filter is that of gyros, which unequal radii do not bend: 1e-5 rad/m is 4 mrad in the 400 m of
a drive of the real car, where 1e-4 or 3e-4 more than double the error after an outage
(`tests/accuracy/car_outage.py`).
"""


def sigmas_for_wheel_speeds() -> ConstantSigmas:
    """Return the priors for headings from the difference of two wheel speeds.

    Radii differ by 0.1 % on a track of half a metre, the track width by 2 %.
    """
    return ConstantSigmas(wheel_radius=0.01, yaw_scale=0.02, yaw_rate=1e-3, curvature=2e-3)


def sigmas_for_wheel_filter(radius: float, yaw_scale: Sequence[float], yaw_rate: float) -> ConstantSigmas:
    """Return the priors for the track of the wheel filter, from its final 1 sigma.

    radius: fraction, mean of the wheels. yaw_rate: rad/s, mean of the wheels. yaw_scale: fraction, one for
    each wheel; both estimate the same yaw scale, so the smallest counts.
    """
    return ConstantSigmas(
        wheel_radius=max(radius, _MIN_SIGMAS.wheel_radius),
        yaw_scale=max(min(yaw_scale), _MIN_SIGMAS.yaw_scale),
        yaw_rate=max(yaw_rate, _MIN_SIGMAS.yaw_rate),
        curvature=_MIN_SIGMAS.curvature,
    )
