"""Names and units of the noise terms of IEEE 952 (gyros) and IEEE 1293 (accelerometers)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hubodo.unit_systems import (
    ACCELERATION,
    ANGLE,
    ANGLE_RANDOM_WALK,
    RATE,
    RATE_RAMP,
    RATE_RANDOM_WALK,
    DisplayUnit,
)

_S_PER_HOUR = 3600.0


@dataclass(frozen=True)
class TermUnit(DisplayUnit):
    """The units of a noise term, and its name."""

    name: str


GYRO_TERM_UNITS = {
    "Q": TermUnit("rad", "deg", ANGLE.factor, "quantisation noise"),
    "N": TermUnit("rad/√s", "deg/√h", ANGLE_RANDOM_WALK.factor, "angle random walk"),
    "B": TermUnit("rad/s", "deg/h", RATE.factor, "bias instability"),
    "K": TermUnit("rad/s/√s", "deg/h/√h", RATE_RANDOM_WALK.factor, "rate random walk"),
    "R": TermUnit("rad/s²", "deg/h/h", RATE_RAMP.factor, "rate ramp"),
}
_MICRO_G_PER_M_S2 = 1e3 * ACCELERATION.factor
ACCEL_TERM_UNITS = {
    "Q": TermUnit("m/s", "m/s", 1.0, "quantisation noise"),
    "N": TermUnit("m/s/√s", "m/s/√h", math.sqrt(_S_PER_HOUR), "velocity random walk"),
    "B": TermUnit("m/s²", "µg", _MICRO_G_PER_M_S2, "bias instability"),
    "K": TermUnit("m/s²/√s", "µg/√h", _MICRO_G_PER_M_S2 * math.sqrt(_S_PER_HOUR), "acceleration random walk"),
    "R": TermUnit("m/s²/s", "µg/h", _MICRO_G_PER_M_S2 * _S_PER_HOUR, "acceleration ramp"),
}
GYRO_RATE_UNIT = TermUnit("rad/s", "deg/h", RATE.factor, "rate")
ACCEL_RATE_UNIT = TermUnit("m/s²", "µg", _MICRO_G_PER_M_S2, "specific force")


def is_gyro(channel: str) -> bool:
    """Return True if a node's column is a gyro axis, False if it is an accelerometer axis."""
    return channel.startswith("g")


def term_units(channel: str) -> dict[str, TermUnit]:
    """Return the units of the noise terms, by term, of a channel gx, gy, gz, ax, ay or az."""
    return GYRO_TERM_UNITS if is_gyro(channel) else ACCEL_TERM_UNITS


def rate_unit(channel: str) -> TermUnit:
    """Return the unit of the Allan deviation of a channel."""
    return GYRO_RATE_UNIT if is_gyro(channel) else ACCEL_RATE_UNIT
