"""Names and units of the noise terms of IEEE 952 (gyros) and IEEE 1293 (accelerometers)."""

from __future__ import annotations

import math
from dataclasses import dataclass

DEG_PER_RAD = math.degrees(1.0)
S_PER_HOUR = 3600.0


@dataclass(frozen=True)
class TermUnit:
    """Name of a noise term, its SI unit, the unit common in data sheets, and common = factor * SI."""

    name: str
    si: str
    common: str
    factor: float


GYRO_TERM_UNITS = {
    "Q": TermUnit("quantisation noise", "rad", "deg", DEG_PER_RAD),
    "N": TermUnit("angle random walk", "rad/√s", "deg/√h", DEG_PER_RAD * math.sqrt(S_PER_HOUR)),
    "B": TermUnit("bias instability", "rad/s", "deg/h", DEG_PER_RAD * S_PER_HOUR),
    "K": TermUnit(
        "rate random walk", "rad/s/√s", "deg/h/√h", DEG_PER_RAD * S_PER_HOUR * math.sqrt(S_PER_HOUR)
    ),
    "R": TermUnit("rate ramp", "rad/s²", "deg/h/h", DEG_PER_RAD * S_PER_HOUR * S_PER_HOUR),
}
_MICRO_G_PER_M_S2 = 1e6 / 9.80665
ACCEL_TERM_UNITS = {
    "Q": TermUnit("quantisation noise", "m/s", "m/s", 1.0),
    "N": TermUnit("velocity random walk", "m/s/√s", "m/s/√h", math.sqrt(S_PER_HOUR)),
    "B": TermUnit("bias instability", "m/s²", "µg", _MICRO_G_PER_M_S2),
    "K": TermUnit("acceleration random walk", "m/s²/√s", "µg/√h", _MICRO_G_PER_M_S2 * math.sqrt(S_PER_HOUR)),
    "R": TermUnit("acceleration ramp", "m/s²/s", "µg/h", _MICRO_G_PER_M_S2 * S_PER_HOUR),
}
GYRO_RATE_UNIT = TermUnit("rate", "rad/s", "deg/h", DEG_PER_RAD * S_PER_HOUR)
ACCEL_RATE_UNIT = TermUnit("specific force", "m/s²", "µg", _MICRO_G_PER_M_S2)


def is_gyro(channel: str) -> bool:
    """Return True if a node's column is a gyro axis, False if it is an accelerometer axis."""
    return channel.startswith("g")


def term_units(channel: str) -> dict[str, TermUnit]:
    """Return the units of the noise terms, by term, of a channel gx, gy, gz, ax, ay or az."""
    return GYRO_TERM_UNITS if is_gyro(channel) else ACCEL_TERM_UNITS


def rate_unit(channel: str) -> TermUnit:
    """Return the unit of the Allan deviation of a channel."""
    return GYRO_RATE_UNIT if is_gyro(channel) else ACCEL_RATE_UNIT
