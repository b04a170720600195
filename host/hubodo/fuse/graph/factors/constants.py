"""The constants of a drive that the graph solves for beside the poses, and what is known of them
beforehand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.linear import Linear

SCALE, TURN, RATE, CURVE, DELAY, COMPASS = range(6)
COUNT = 6


@dataclass(frozen=True, slots=True)
class ConstantSigmas:
    """1 sigma of each constant before the drive, in the order of their numbers; each is zero in the mean.
    The values are those of headings from gyros on wheels.

    scale: of the distance, a fraction: the wheels' common radius error. turn: of the heading's increments,
    a fraction: the gyros' scale, or minus the track's error where the heading comes from the wheels'
    difference. rate: rad/s, the heading's drift at rest too: gyro bias. curve: rad/m, its drift with the
    way: the difference of the wheels' radii over radius and track. delay: s that GNSS time stamps come
    before the place they name. compass: rad that headings read too much.
    """

    scale: float = 0.005
    turn: float = 0.01
    rate: float = 2e-4
    curve: float = 3e-4
    delay: float = 0.05
    compass: float = 0.03

    def array(self) -> Array:
        """(6,) in the order of the numbers above."""
        return np.array([getattr(self, item.name) for item in fields(self)])


def of_wheel_speeds() -> ConstantSigmas:
    """For headings from the difference of two wheel speeds: radii apart by 0.1 % on a track of half a
    metre, 2 % of track."""
    return ConstantSigmas(scale=0.01, turn=0.02, rate=1e-3, curve=2e-3)


def of_wheel_filter(
    radius: Sequence[float], yaw_scale: Sequence[float], yaw_rate: Sequence[float]
) -> ConstantSigmas:
    """For the track of the wheel filter, from the 1 sigma that it has of each wheel at its end.

    radius, yaw_scale: fractions. yaw_rate: rad/s. The scale of yaw that two wheels agree on is one number,
    known as well on each; what else is wrong differs from wheel to wheel.
    """
    share = 1.0 / len(radius)
    return ConstantSigmas(
        scale=max(share * math.hypot(*radius), _LEAST.scale),
        turn=max(min(yaw_scale), _LEAST.turn),
        rate=max(share * math.hypot(*yaw_rate), _LEAST.rate),
        curve=_LEAST.curve,
    )


_LEAST = ConstantSigmas(scale=5e-4, turn=1e-3, rate=5e-5, curve=1e-4)
"""What a tyre and a road change from hour to hour, whatever was measured before."""

NAMES: tuple[str, ...] = tuple(item.name for item in fields(ConstantSigmas))


@dataclass(frozen=True, eq=False)
class ConstantsFactor:
    """Prior of the constants, (6,) mean and 1 sigma; a sigma of 0 holds a constant at its mean."""

    mean: Array
    sigma: Array

    def linear(self, constants: Array) -> Linear:
        """One row of six, on no state."""
        share = 1.0 / np.maximum(self.sigma, 1e-9)
        residual = ((constants - self.mean) * share)[None]
        nothing = np.zeros((1, COUNT, 3))
        return Linear(np.zeros(1, np.intp), residual, nothing, None, np.diag(share)[None])
