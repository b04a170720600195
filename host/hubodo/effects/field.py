"""Effects that the field knows and the list lacks: candidates only where somebody asks for them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import (
    REFERENCE_CELSIUS,
    REFERENCE_VOLTS,
    Chain,
    Effect,
    Follows,
    Geometry,
    Level,
    parameter,
)
from hubodo.effects.dependence import steering_rate

# m/s²: the torque turns round within so much of acceleration.
_TURNS_ROUND = 0.05


@dataclass(frozen=True)
class WheelSteering(Effect):
    """The wheel steers by arm r v / (v² + 1/4), and its node turns with it about the vertical."""

    name: ClassVar[str] = "wheel_steering"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the wheel is steered by the bend of the path"
    alike: ClassVar[Mapping[str, str]] = {
        "gyro_scale_factor": "begin and end turns briskly: steering shows only then"
    }
    arm: float = parameter("m", 0.3)

    def offset(self, chain: Chain) -> None:
        rate = self.arm * steering_rate(chain)
        chain.gyro[0] += np.cos(chain.angle) * rate
        chain.gyro[1] -= chain.facing * np.sin(chain.angle) * rate


@dataclass(frozen=True)
class AxlePlay(Effect):
    """The node tips to the other end of its play, a rotation vector across the axle, with the torque."""

    name: ClassVar[str] = "axle_play"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the axle or the node's mount has play"
    alike: ClassVar[Mapping[str, str]] = {
        "wheel_slip": "accelerate and brake by little and by much: play is the same for both",
    }
    x: float = parameter("rad", 0.005)
    y: float = parameter("rad", 0.005, turned=True)

    def offset(self, chain: Chain) -> None:
        tip = np.array([self.x, self.y, 0.0])
        end = np.tanh(np.asarray(chain.acceleration) / _TURNS_ROUND)
        chain.gyro -= end * np.cross(tip, chain.rate, axisb=0).T
        chain.accel -= end * np.cross(tip, chain.force, axisb=0).T


@dataclass(frozen=True)
class AccelRectification(Effect):
    """k v² more on each axis: shaking, which grows with the speed, shifts the zero as its square."""

    name: ClassVar[str] = "accel_rectification"
    meaning: ClassVar[str] = "vibration shifts the accelerometer's zero"
    alike: ClassVar[Mapping[str, str]] = {
        "lever_arm": "drive a smooth floor and a rough one: only shaking changes",
    }
    x: float = parameter("(m/s²)/(m²/s²)", 0.01)
    y: float = parameter("(m/s²)/(m²/s²)", 0.01, turned=True)
    z: float = parameter("(m/s²)/(m²/s²)", 0.01, turned=True)

    def offset(self, chain: Chain) -> None:
        chain.accel += np.array([[self.x], [self.y], [self.z]]) * np.asarray(chain.speed) ** 2


@dataclass(frozen=True)
class AccelTemperature(Effect):
    """An offset in proportion to the temperature above 25 °C."""

    name: ClassVar[str] = "accel_temperature"
    follows: ClassVar[Follows | None] = "temperature"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the accelerometer's offset follows the temperature"
    alike: ClassVar[Mapping[str, str]] = {
        "accel_bias": "let the temperature change by some degrees",
    }
    x: float = parameter("(m/s²)/°C", 0.01)
    y: float = parameter("(m/s²)/°C", 0.01, turned=True)
    z: float = parameter("(m/s²)/°C", 0.01, turned=True)

    def offset(self, chain: Chain) -> None:
        chain.accel += np.array([[self.x], [self.y], [self.z]]) * (chain.temperature - REFERENCE_CELSIUS)


@dataclass(frozen=True)
class GyroSupply(Effect):
    """An offset in proportion to the supply voltage above 3.7 V."""

    name: ClassVar[str] = "gyro_supply"
    follows: ClassVar[Follows | None] = "supply"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro's offset follows the supply voltage"
    alike: ClassVar[Mapping[str, str]] = {
        "gyro_bias": "let the battery run down a little, or feed the node from two supplies",
        "gyro_temperature": "feed the node from two supplies while its temperature stays",
    }
    x: float = parameter("(rad/s)/V", 0.01)
    y: float = parameter("(rad/s)/V", 0.01, turned=True)
    z: float = parameter("(rad/s)/V", 0.01, turned=True)

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]]) * (chain.supply - REFERENCE_VOLTS)


@dataclass(frozen=True)
class RoadBank(Effect):
    """The road leans at a constant angle: the left side is higher where it is positive."""

    name: ClassVar[str] = "road_bank"
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the road is banked"
    alike: ClassVar[Mapping[str, str]] = {
        "accel_bias": "drive the same road in both directions",
    }
    angle: float = parameter("rad", 0.03, within=1.5)

    def offset(self, chain: Chain) -> None:
        aside = STANDARD_GRAVITY * math.sin(self.angle)
        less = STANDARD_GRAVITY * (math.cos(self.angle) - 1.0)
        chain.accel[0] += np.cos(chain.angle) * less
        chain.accel[1] -= chain.facing * np.sin(chain.angle) * less
        chain.accel[2] += chain.facing * aside


@dataclass(frozen=True)
class ReferenceLatency(Effect):
    """The reference tells at t what was true at t - delay; every node is early beside it."""

    name: ClassVar[str] = "reference_latency"
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the reference is late"
    alike: ClassVar[Mapping[str, str]] = {
        "time_offset": "no drive: nothing tells which clock is right",
    }
    delay: float = parameter("s", 0.05)

    def true_time(self, t: Array) -> Array:
        return t + self.delay


@dataclass(frozen=True)
class ReferenceArm(Effect):
    """The reference's antenna sits this far left of the vehicle's middle: its speed is v - r arm."""

    name: ClassVar[str] = "reference_arm"
    of_reference: ClassVar[bool] = True
    level: ClassVar[Level] = "vehicle"
    meaning: ClassVar[str] = "the reference's antenna is not in the middle of the vehicle"
    alike: ClassVar[Mapping[str, str]] = {
        "track_width": "have a node on a wheel of each side: an arm speeds up both in the same turn",
    }
    arm: float = parameter("m", 0.2)

    def shape(self, geometry: Geometry) -> Geometry:
        return replace(geometry, aside=geometry.aside + self.arm)

    def in_words(self) -> str:
        side = "left" if self.arm > 0.0 else "right"
        return f"the reference's antenna sits {abs(self.arm):.2g} m {side} of the middle of the vehicle"


FIELD: tuple[type[Effect], ...] = (
    WheelSteering,
    AxlePlay,
    AccelRectification,
    AccelTemperature,
    GyroSupply,
    RoadBank,
    ReferenceLatency,
    ReferenceArm,
)
