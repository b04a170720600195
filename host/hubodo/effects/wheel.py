"""Effects of a wheel: radius, growth with spin, slip, eccentricity, camber."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Effect, Estimate, Geometry, Level, parameter

_COUNT = "drive long and fast: gravity turning in ax and ay counts revolutions"
_TWO_SPEEDS = "drive slowly and fast for as long each"
_RADIUS = Estimate(
    0.004,
    2e-5,
    "a tape measure around the tyre; walk: pressure and load, 1 mm/m in an hour",
    "drive farther, or with better positions",
)
_CAMBER = Estimate(0.05, 1e-5, "three degrees, beyond what is built; walk: suspension and load")


@dataclass(frozen=True)
class WheelRadius(Effect):
    """R (1 + error)."""

    name: ClassVar[str] = "wheel_radius"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel has another radius than the model says"
    alike: ClassVar[Mapping[str, str]] = {
        "gyro_scale_factor": _COUNT,
        "tyre_growth": _TWO_SPEEDS,
        "clock_skew": "change speed now and then: a skew is late at every change",
    }
    error: float = parameter("1", 0.01, within=0.9, estimate=_RADIUS)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, radius=geometry.radius * (1.0 + self.error))


@dataclass(frozen=True)
class TyreGrowth(Effect):
    """R (1 + k theta'²): the tyre grows with its spin."""

    name: ClassVar[str] = "tyre_growth"
    remembers: ClassVar[bool] = True
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the tyre grows with its spin"
    alike: ClassVar[Mapping[str, str]] = {
        "gyro_cubic": _COUNT,
    }
    k: float = parameter("s²/rad²", 2e-5)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, growth=geometry.growth + self.k)


@dataclass(frozen=True)
class WheelSlip(Effect):
    """theta' = v_w / R (1 + k v_w'): the wheel turns faster than it rolls while it pulls."""

    name: ClassVar[str] = "wheel_slip"
    remembers: ClassVar[bool] = True
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel slips when it pulls or brakes"
    alike: ClassVar[Mapping[str, str]] = {
        "time_offset": "accelerate at different speeds, and turn while at it",
    }
    k: float = parameter("s²/m", 0.01)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, slip=geometry.slip + self.k)


@dataclass(frozen=True)
class WheelEccentricity(Effect):
    """theta' = v_w / (R (1 + amplitude cos(theta - phase))).

    Its coordinates are amplitude cos(phase) and amplitude sin(phase): the phase of nothing is not defined.
    """

    name: ClassVar[str] = "wheel_eccentricity"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel does not turn about its centre"
    amplitude: float = parameter("1", 0.01, within=0.9)
    phase: float = parameter("rad", 2.0)

    @classmethod
    def coordinate_scales(cls) -> Array:
        return np.full(2, cls.scale("amplitude"))

    def coordinates(self) -> Array:
        return self.amplitude * np.array([math.cos(self.phase), math.sin(self.phase)])

    def at(self, coordinates: Array) -> WheelEccentricity:
        c, s = map(float, coordinates)
        return WheelEccentricity(math.hypot(c, s), math.atan2(s, c))

    def shape(self, geometry: Geometry) -> Geometry:
        c, s = self.coordinates()
        before = geometry.eccentricity
        return replace(geometry, eccentricity=(before[0] + float(c), before[1] + float(s)))


@dataclass(frozen=True)
class WheelCamber(Effect):
    """The wheel top leans inwards by this angle."""

    name: ClassVar[str] = "wheel_camber"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel leans"
    alike: ClassVar[Mapping[str, str]] = {
        "accel_bias": "turn both ways at speed: camber shows in gz, a bias does not",
    }
    angle: float = parameter("rad", 0.05, within=1.5, estimate=_CAMBER)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, camber=geometry.camber + self.angle)
