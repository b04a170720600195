"""Names and units of the noise terms of IEEE 952 (gyros) and IEEE 1293 (accelerometers)."""

from __future__ import annotations

import math
from dataclasses import dataclass

DEG = math.degrees(1.0)
HOUR = 3600.0


@dataclass(frozen=True)
class Unit:
    """SI unit of a term, the customary one, and what to multiply SI with to get it."""

    name: str
    si: str
    customary: str
    factor: float


GYRO = {
    "Q": Unit("quantisation noise", "rad", "deg", DEG),
    "N": Unit("angle random walk", "rad/√s", "deg/√h", DEG * math.sqrt(HOUR)),
    "B": Unit("bias instability", "rad/s", "deg/h", DEG * HOUR),
    "K": Unit("rate random walk", "rad/s/√s", "deg/h/√h", DEG * HOUR * math.sqrt(HOUR)),
    "R": Unit("rate ramp", "rad/s²", "deg/h/h", DEG * HOUR * HOUR),
}
_MICRO_G = 1e6 / 9.80665
ACCEL = {
    "Q": Unit("quantisation noise", "m/s", "m/s", 1.0),
    "N": Unit("velocity random walk", "m/s/√s", "m/s/√h", math.sqrt(HOUR)),
    "B": Unit("bias instability", "m/s²", "µg", _MICRO_G),
    "K": Unit("acceleration random walk", "m/s²/√s", "µg/√h", _MICRO_G * math.sqrt(HOUR)),
    "R": Unit("acceleration ramp", "m/s²/s", "µg/h", _MICRO_G * HOUR),
}
GYRO_RATE = Unit("rate", "rad/s", "deg/h", DEG * HOUR)
ACCEL_RATE = Unit("specific force", "m/s²", "µg", _MICRO_G)


def is_gyro(channel: str) -> bool:
    """Whether a node's column is a gyro axis; the others are the accelerometer's."""
    return channel.startswith("g")


def units(channel: str) -> dict[str, Unit]:
    """Terms by name for a channel gx, gy, gz, ax, ay or az."""
    return GYRO if is_gyro(channel) else ACCEL


def rate_unit(channel: str) -> Unit:
    """Unit of the Allan deviation of a channel."""
    return GYRO_RATE if is_gyro(channel) else ACCEL_RATE
