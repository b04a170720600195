"""The constants of a drive that the graph solves for beside the poses, and what is known of them before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from hubodo.arrays import Array


@dataclass(frozen=True, slots=True)
class ConstantSigmas:
    """1 sigma of each constant before the drive, in the order of their numbers.

    Each is zero in the mean, and what is to be added to the odometry. The values are those of headings from
    gyros on wheels.

    wheel_radius: the effect of that name, common to both wheels: a fraction of the distance. A tyre measured
    by tape is known to half a percent.
    yaw_scale: of the heading's increments, a fraction: minus gyro_scale_factor across the axle, 1 % by data
    sheets of MEMS gyros, or minus track_width where the heading comes from the wheels' difference.
    yaw_rate: rad/s, minus gyro_bias about the vertical: 40 deg/h, what a filter at rest leaves of it.
    curvature: rad/m, the difference of the wheels' radii over radius and track: 0.015 % on half a metre.
    gnss_delay: s that GNSS time stamps come before the place they name: a quarter of an epoch at 5 Hz.
    compass_offset: rad that headings read too much: a compass mounted by eye, 2 deg.
    """

    wheel_radius: float = 0.005
    yaw_scale: float = 0.01
    yaw_rate: float = 2e-4
    curvature: float = 3e-4
    gnss_delay: float = 0.05
    compass_offset: float = 0.03

    def to_array(self) -> Array:
        """(COUNT,) in the order of the numbers below."""
        return np.array([getattr(self, name) for name in CONSTANT_NAMES])


CONSTANT_NAMES: tuple[str, ...] = tuple(item.name for item in fields(ConstantSigmas))
N_CONSTANTS = len(CONSTANT_NAMES)
WHEEL_RADIUS, YAW_SCALE, YAW_RATE, CURVATURE, GNSS_DELAY, COMPASS_OFFSET = range(N_CONSTANTS)

_MIN_SIGMAS = ConstantSigmas(wheel_radius=5e-4, yaw_scale=1e-3, yaw_rate=5e-5, curvature=1e-4)
"""What a tyre and a road change from hour to hour, whatever was measured before.

The pressure of a tyre with 10 degrees of warmth, a gyro's scale with its temperature, 10 deg/h of bias, 0.005
% of radii.
"""


def sigmas_for_wheel_speeds() -> ConstantSigmas:
    """For headings from the difference of two wheel speeds.

    Radii apart by 0.1 % on a track of half a metre, 2 % of track.
    """
    return ConstantSigmas(wheel_radius=0.01, yaw_scale=0.02, yaw_rate=1e-3, curvature=2e-3)


def sigmas_for_wheel_filter(
    radius: Sequence[float], yaw_scale: Sequence[float], yaw_rate: Sequence[float]
) -> ConstantSigmas:
    """For the track of the wheel filter, from the 1 sigma that it has of each wheel at its end.

    radius, yaw_scale: fractions. yaw_rate: rad/s. The scale of yaw that two wheels agree on is one number,
    known as well on each; what else is wrong differs from wheel to wheel.
    """
    share = 1.0 / len(radius)
    return ConstantSigmas(
        wheel_radius=max(share * math.hypot(*radius), _MIN_SIGMAS.wheel_radius),
        yaw_scale=max(min(yaw_scale), _MIN_SIGMAS.yaw_scale),
        yaw_rate=max(share * math.hypot(*yaw_rate), _MIN_SIGMAS.yaw_rate),
        curvature=_MIN_SIGMAS.curvature,
    )
