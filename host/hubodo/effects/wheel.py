"""Effects of a wheel: radius, tyre growth, slip, eccentricity and camber.

R is the nominal wheel radius, theta' the spin and v_w the speed of the wheel contact over the ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Effect, Level, OdometryPrior, parameter
from hubodo.effects.sensor_chain import Geometry

_COUNT_TURNS_ADVICE = "drive long and fast: gravity in ax and ay counts the turns of the wheel"
_RADIUS_PRIOR = OdometryPrior(
    0.004,
    2e-5,
    "tape measure around the tyre; random walk: pressure and load, 1 mm/m in an hour",
    "drive farther, or with better positions",
)
_CAMBER_PRIOR = OdometryPrior(
    0.05, 1e-5, "three degrees beyond the design value; random walk: suspension and load"
)


@dataclass(frozen=True)
class WheelRadius(Effect):
    """The wheel radius is R (1 + error)."""

    name: ClassVar[str] = "wheel_radius"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel radius differs from the model"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "gyro_scale_factor": _COUNT_TURNS_ADVICE,
        "tyre_growth": "drive slowly and fast for the same time each",
        "clock_skew": "change speed now and then: a clock skew delays every change",
    }
    error: float = parameter("1", 0.01, max_magnitude=0.9, odometry_prior=_RADIUS_PRIOR)

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        return replace(geometry, radius=geometry.radius * (1.0 + self.error))


@dataclass(frozen=True)
class TyreGrowth(Effect):
    """The tyre grows with its spin: the radius is R (1 + k theta'²)."""

    name: ClassVar[str] = "tyre_growth"
    has_memory: ClassVar[bool] = True
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the tyre grows with its spin"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "gyro_cubic": _COUNT_TURNS_ADVICE,
    }
    k: float = parameter("s²/rad²", 2e-5)

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        return replace(geometry, tyre_growth=geometry.tyre_growth + self.k)


@dataclass(frozen=True)
class WheelSlip(Effect):
    """The wheel slips under drive and brake torque: theta' = v_w / R (1 + k v_w'), with slip factor k."""

    name: ClassVar[str] = "wheel_slip"
    has_memory: ClassVar[bool] = True
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel slips under drive and brake torque"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "time_offset": "accelerate at different speeds, on straights and in turns",
    }
    k: float = parameter("s²/m", 0.01)

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        return replace(geometry, wheel_slip=geometry.wheel_slip + self.k)


@dataclass(frozen=True)
class WheelEccentricity(Effect):
    """The axle is off the wheel centre: theta' = v_w / (R (1 + amplitude cos(theta - phase))).

    The coordinates of a fit are amplitude cos(phase) and amplitude sin(phase), which stay defined at zero.
    """

    name: ClassVar[str] = "wheel_eccentricity"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the axle is not at the centre of the wheel"
    amplitude: float = parameter("1", 0.01, max_magnitude=0.9)
    phase: float = parameter("rad", 2.0, max_plausible=math.inf)

    @classmethod
    def coordinate_scales(cls) -> Array:
        return np.full(2, cls.scale("amplitude"))

    def coordinates(self) -> Array:
        return self.amplitude * np.array([math.cos(self.phase), math.sin(self.phase)])

    def with_coordinates(self, coordinates: Array) -> WheelEccentricity:
        c, s = map(float, coordinates)
        return WheelEccentricity(math.hypot(c, s), math.atan2(s, c))

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        c, s = self.coordinates()
        c0, s0 = geometry.eccentricity
        return replace(geometry, eccentricity=(c0 + float(c), s0 + float(s)))


@dataclass(frozen=True)
class WheelCamber(Effect):
    """The wheel top leans inwards by an angle."""

    name: ClassVar[str] = "wheel_camber"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel leans"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "accel_bias": "turn both ways at speed: camber shows in gz, a bias does not",
    }
    angle: float = parameter("rad", 0.05, max_plausible=0.6, max_magnitude=1.5, odometry_prior=_CAMBER_PRIOR)

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        return replace(geometry, camber=geometry.camber + self.angle)
