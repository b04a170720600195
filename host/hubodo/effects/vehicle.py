"""Effects of the vehicle and the road: track width, grade and bank."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import Effect, Level, OdometryPrior, Visibility, parameter
from hubodo.effects.sensor_chain import Geometry, SensorChain

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

_ROAD_SEED = 29  # seed of the simulated road, which all nodes and runs share


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
    varies_between_drives: ClassVar[bool] = True
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the road is not level"
    confusable_with: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("gyro_nonorthogonality", "accel_nonorthogonality", "accel_bias", "node_misalignment"),
        "drive the same road in both directions",
    )
    # One constant for a whole log: mountain passes climb by 0.1 rad, wheelchair ramps by 0.08 (1:12).
    angle: float = parameter(
        "rad", 0.03, max_plausible=0.1, max_magnitude=1.5, odometry_prior=_ROAD_GRADE_PRIOR
    )

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        return replace(geometry, grade=geometry.grade + self.angle)


@dataclass(frozen=True)
class RoadBank(Effect):
    """The road leans across the path at a varying angle, positive where the left side is higher.

    The angle is a first-order Gauss-Markov process of the distance: variance sigma², correlation
    exp(-distance / length). A banked vehicle measures g sin(angle) to the left.
    """

    name: ClassVar[str] = "road_bank"
    varies_between_drives: ClassVar[bool] = True
    level: ClassVar[Level] = "vehicle"
    visible_in: ClassVar[Visibility] = "scatter"
    meaning: ClassVar[str] = "the road leans to the side"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "accel_bias": "drive the same road in both directions: the bank changes sign, a bias does not",
        "lever_arm": "drive the same turns on level ground: a lever arm along the axle shows there too",
        "wheel_camber": "drive the same road in both directions: camber does not change sign",
    }
    sigma: float = parameter("rad", 0.02, positive=True, max_magnitude=0.5)
    length: float = parameter("m", 50.0, positive=True, default=50.0)

    def bank_process(self) -> tuple[float, float]:
        return self.sigma, self.length

    def describe(self) -> str:
        return f"the road leans to the side by {math.degrees(self.sigma):.1f}° rms"

    def add_random_walk(self, chain: SensorChain, rng: np.random.Generator) -> None:
        """Add the force of a bank that is the same for all nodes at the same distance."""
        speed = np.broadcast_to(np.abs(chain.speed), chain.t.shape)
        distance = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(chain.t))])
        force = STANDARD_GRAVITY * np.sin(_bank_profile(distance, self.sigma, self.length))
        if np.ndim(chain.spin):
            chain.accel[2] += chain.facing * force
        else:
            chain.accel[1] += force


def _bank_profile(distance: Array, sigma: float, length: float) -> Array:
    """Return the bank, (N,) rad, of one fixed road at each distance in m: exact steps between metres."""
    grid = np.arange(0.0, float(distance[-1]) + 2.0)
    draws = np.random.default_rng(_ROAD_SEED).standard_normal(len(grid)) * sigma
    decay = math.exp(-1.0 / length)
    profile = np.empty_like(grid)
    profile[0] = draws[0]
    for k in range(1, len(grid)):
        profile[k] = decay * profile[k - 1] + math.sqrt(1.0 - decay**2) * draws[k]
    return np.interp(distance, grid, profile)
