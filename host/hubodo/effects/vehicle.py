"""Effects of the vehicle and its road: track width, grade."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import Effect, Estimate, Geometry, Level, parameter

_TRACK = Estimate(
    0.03,
    0.0,
    "a tape measure on a wide tyre that runs on an edge, as a real car showed; walk: it is fixed",
    "drive curves: turns that add up to well over 180 degrees, to both sides",
)
_SLOPE = 0.15 / STANDARD_GRAVITY
_ROAD = Estimate(
    _SLOPE,
    _SLOPE * math.sqrt(2.0 / 10.0),
    "1.5 % of grade that changes over ten seconds of driving",
    forgets=10.0,
)


@dataclass(frozen=True)
class TrackWidth(Effect):
    """The contacts are b (1 + error) apart."""

    name: ClassVar[str] = "track_width"
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the wheels are not as far apart as the model says"
    alike: ClassVar[Mapping[str, str]] = {
        "wheel_camber": "turn both ways at speed: camber shows in az, gx and gy",
        "wheel_radius": "drive straight for as long as in turns",
        "gyro_scale_factor": "turn both ways: a scale error shows in straights too",
    }
    error: float = parameter("1", 0.02, within=0.9, estimate=_TRACK)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, track_width=geometry.track_width * (1.0 + self.error))


@dataclass(frozen=True)
class RoadGrade(Effect):
    """The road climbs at a constant angle."""

    name: ClassVar[str] = "road_grade"
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the road is not level"
    alike: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("gyro_nonorthogonality", "accel_nonorthogonality", "accel_bias", "node_misalignment"),
        "drive the same road in both directions",
    )
    angle: float = parameter("rad", 0.03, within=1.5, estimate=_ROAD)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, grade=geometry.grade + self.angle)
