"""Effects of the vehicle and its road: track width, grade."""

from dataclasses import dataclass, replace
from typing import ClassVar

from hubodo.effects.base import Effect, Geometry, Level, parameter


@dataclass(frozen=True)
class TrackWidth(Effect):
    """The contacts are b (1 + error) apart."""

    name: ClassVar[str] = "track_width"
    level: ClassVar[Level] = "vehicle"
    error: float = parameter("1", 0.02, within=0.9)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, track_width=geometry.track_width * (1.0 + self.error))


@dataclass(frozen=True)
class RoadGrade(Effect):
    """The road climbs at a constant angle."""

    name: ClassVar[str] = "road_grade"
    level: ClassVar[Level] = "vehicle"
    angle: float = parameter("rad", 0.03, within=1.5)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, grade=geometry.grade + self.angle)
