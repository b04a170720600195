"""Effects of the vehicle and the road: track width and grade."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import Effect, Geometry, Level, OdometryPrior, parameter

_TRACK_WIDTH_PRIOR = OdometryPrior(
    0.03,
    0.0,
    "tape measure on a wide tyre that runs on its edge, as seen on a real car; random walk: none, fixed",
    "drive curves: turns that add up to well over 180 degrees, to both sides",
)
_ROAD_GRADE_SIGMA = 0.15 / STANDARD_GRAVITY  # rad, a grade of 1.5 %
_ROAD_GRADE_TIME = 10.0  # s, correlation time of the grade while driving
_ROAD_GRADE_PRIOR = OdometryPrior(
    _ROAD_GRADE_SIGMA,
    _ROAD_GRADE_SIGMA * math.sqrt(2.0 / _ROAD_GRADE_TIME),
    "a grade of 1.5 % with a correlation time of ten seconds",
    correlation_time=_ROAD_GRADE_TIME,
)


@dataclass(frozen=True)
class TrackWidth(Effect):
    """The track width is b (1 + error), with nominal width b."""

    name: ClassVar[str] = "track_width"
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the track width differs from the model"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "wheel_camber": "turn both ways at speed: camber shows in az, gx and gy",
        "wheel_radius": "drive straight for as long as you turn",
        "gyro_scale_factor": "turn both ways: a scale error shows on straights too",
    }
    error: float = parameter("1", 0.02, max_magnitude=0.9, odometry_prior=_TRACK_WIDTH_PRIOR)

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        return replace(geometry, track_width=geometry.track_width * (1.0 + self.error))


@dataclass(frozen=True)
class RoadGrade(Effect):
    """The road climbs at a constant angle, positive uphill."""

    name: ClassVar[str] = "road_grade"
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the road is not level"
    confusable_with: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("gyro_nonorthogonality", "accel_nonorthogonality", "accel_bias", "node_misalignment"),
        "drive the same road in both directions",
    )
    angle: float = parameter("rad", 0.03, max_magnitude=1.5, odometry_prior=_ROAD_GRADE_PRIOR)

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        return replace(geometry, grade=geometry.grade + self.angle)
