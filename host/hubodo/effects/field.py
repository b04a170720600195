"""Effects from the literature that `hubodo gap` considers only on request."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import Dependency, Effect, Level, parameter
from hubodo.effects.dependence import steering_rate
from hubodo.effects.sensor_chain import REFERENCE_VOLTS, Geometry, SensorChain
from hubodo.effects.temperature import AccelTemperature

_TORQUE_REVERSAL_ACCEL = 0.05  # m/s², width of the transition between the two ends of the play


@dataclass(frozen=True)
class WheelSteering(Effect):
    """The wheel steers by the angle arm r v / (v² + 1/4), with yaw rate r and speed v in SI units."""

    name: ClassVar[str] = "wheel_steering"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel steers with the curvature of the path"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "gyro_scale_factor": "begin and end turns briskly: steering shows only there"
    }
    arm: float = parameter("m", 0.3)

    def add_offsets(self, chain: SensorChain) -> None:
        rate = self.arm * steering_rate(chain)
        chain.gyro[0] += np.cos(chain.angle) * rate
        chain.gyro[1] -= chain.facing * np.sin(chain.angle) * rate


@dataclass(frozen=True)
class AxlePlay(Effect):
    """The node tilts across the axle by a rotation vector whose sign follows the torque on the wheel."""

    name: ClassVar[str] = "axle_play"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the axle or the node's mount has play"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "wheel_slip": "accelerate and brake gently and hard: play is the same for both",
    }
    x: float = parameter("rad", 0.005)
    y: float = parameter("rad", 0.005, flips_with_facing=True)

    def add_offsets(self, chain: SensorChain) -> None:
        tilt = np.array([self.x, self.y, 0.0])
        side = np.tanh(np.asarray(chain.acceleration) / _TORQUE_REVERSAL_ACCEL)
        chain.gyro -= side * np.cross(tilt, chain.rate, axisb=0).T
        chain.accel -= side * np.cross(tilt, chain.force, axisb=0).T


@dataclass(frozen=True)
class AccelRectification(Effect):
    """Vibration rectification: each accelerometer axis reads k v² more, with speed v."""

    name: ClassVar[str] = "accel_rectification"
    meaning: ClassVar[str] = "vibration shifts the accelerometer's zero"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "lever_arm": "drive on a smooth floor and on a rough one: only vibration changes",
    }
    x: float = parameter("(m/s²)/(m²/s²)", 0.01)
    y: float = parameter("(m/s²)/(m²/s²)", 0.01, flips_with_facing=True)
    z: float = parameter("(m/s²)/(m²/s²)", 0.01, flips_with_facing=True)

    def add_offsets(self, chain: SensorChain) -> None:
        chain.accel += np.array([[self.x], [self.y], [self.z]]) * np.asarray(chain.speed) ** 2


@dataclass(frozen=True)
class FittedAccelTemperature(AccelTemperature):
    """The accelerometer bias follows the temperature, with linear terms that are fitted to the drive.

    It replaces the effect of the same name, which only a bench record determines.
    """

    confusable_with: ClassVar[Mapping[str, str]] = {
        "accel_bias": "let the temperature change by several degrees",
    }
    x: float = parameter("m/s²/°C", 0.01)
    y: float = parameter("m/s²/°C", 0.01, flips_with_facing=True)
    z: float = parameter("m/s²/°C", 0.01, flips_with_facing=True)


@dataclass(frozen=True)
class GyroSupply(Effect):
    """The gyro bias is proportional to the difference of the supply voltage from 3.7 V."""

    name: ClassVar[str] = "gyro_supply"
    depends_on: ClassVar[Dependency | None] = "supply"
    is_invertible: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro's offset follows the supply voltage"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "gyro_bias": "let the battery discharge a little, or power the node from two supplies",
        "gyro_temperature": "power the node from two supplies at the same temperature",
    }
    x: float = parameter("(rad/s)/V", 0.01)
    y: float = parameter("(rad/s)/V", 0.01, flips_with_facing=True)
    z: float = parameter("(rad/s)/V", 0.01, flips_with_facing=True)

    def add_offsets(self, chain: SensorChain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]]) * (chain.supply - REFERENCE_VOLTS)


@dataclass(frozen=True)
class MeanRoadBank(Effect):
    """The road is banked at a constant angle, positive where the left side is higher."""

    name: ClassVar[str] = "mean_road_bank"
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the road is banked"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "accel_bias": "drive the same road in both directions",
    }
    angle: float = parameter("rad", 0.03, max_magnitude=1.5)

    def add_offsets(self, chain: SensorChain) -> None:
        lateral = STANDARD_GRAVITY * math.sin(self.angle)
        vertical_change = STANDARD_GRAVITY * (math.cos(self.angle) - 1.0)
        chain.accel[0] += np.cos(chain.angle) * vertical_change
        chain.accel[1] -= chain.facing * np.sin(chain.angle) * vertical_change
        chain.accel[2] += chain.facing * lateral


@dataclass(frozen=True)
class ReferenceLatency(Effect):
    """The reference is late: at time t it reports the state at t - delay."""

    name: ClassVar[str] = "reference_latency"
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the reference is late"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "time_offset": "none: a drive cannot show which clock is correct",
    }
    delay: float = parameter("s", 0.05)

    def true_time(self, t: Array) -> Array:
        return t + self.delay


@dataclass(frozen=True)
class ReferenceArm(Effect):
    """The antenna of the reference is off-centre to the left by `arm`: it measures v - r arm.

    v, r: speed in m/s and yaw rate in rad/s of the vehicle.
    """

    name: ClassVar[str] = "reference_arm"
    affects_reference: ClassVar[bool] = True
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the antenna of the reference is not on the centre line of the vehicle"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "track_width": "put a node on a wheel of each side: in a turn an arm has the same sign for both",
    }
    arm: float = parameter("m", 0.2)

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        return replace(geometry, reference_y=geometry.reference_y + self.arm)

    def describe(self) -> str:
        side = "left" if self.arm > 0.0 else "right"
        return (
            f"the antenna of the reference is {abs(self.arm):.2g} m {side} of the centre line of the vehicle"
        )


FIELD_EFFECTS: tuple[type[Effect], ...] = (
    WheelSteering,
    AxlePlay,
    AccelRectification,
    FittedAccelTemperature,
    GyroSupply,
    MeanRoadBank,
    ReferenceLatency,
    ReferenceArm,
)
