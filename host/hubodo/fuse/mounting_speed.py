"""Speeds up to which the sensors of a node measure the spin of its wheel, from radius and ranges."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.ranges import NodeRanges, determine_ranges, node_metadata
from hubodo.vehicle import Vehicle

LISTED_ARMS = (0.02, 0.05, 0.15)
"""m, distances of a sensor from the axle: a hub cap, a spoke, a rim."""


@dataclass(frozen=True, slots=True)
class MountingSpeed:
    """Speeds, m/s, at which the sensors of one node reach their ranges.

    Attributes
    ----------
    node : its name.
    gyro : speed at which the gyro about the axle clips.
    gravity : by distance of the sensor from the axle, m: speed up to which at least one accelerometer across
        the axle shows gravity, in the worst mounting, halfway between its x and y axis. With one of them
        pointing to the axle the other one shows gravity at any speed.
    """

    node: str
    gyro: float
    gravity: Mapping[float, float]

    @property
    def description(self) -> str:
        """Description in one line, for warnings."""
        parts = [f"{speed:.0f} m/s at {100 * arm:.0f} cm" for arm, speed in self.gravity.items()]
        return (
            f"{self.node}: the gyro about the axle clips from {self.gyro:.1f} m/s on; beyond it gravity "
            "shows the spin, at any speed if x or y points to the axle, else at least up to "
            f"{', '.join(parts)} off the axle"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the JSON entry; m and m/s."""
        gravity = [{"arm": arm, "speed": speed} for arm, speed in self.gravity.items()]
        return {"node": self.node, "gyro": self.gyro, "gravity": gravity}


def mounting_speeds(vehicle: Vehicle, metadata: Mapping[str, str]) -> Iterator[MountingSpeed]:
    """Yield the speeds of each node on a wheel; metadata: of a log, empty without one."""
    for name, mount in vehicle.nodes.items():
        if mount.side is not None:
            yield _mounting_speed(
                name, vehicle.wheel_radius, determine_ranges(mount, node_metadata(metadata, name))
            )


def _mounting_speed(name: str, wheel_radius: float, ranges: NodeRanges) -> MountingSpeed:
    gyro_speed = wheel_radius * ranges.gyro.value
    # Halfway between two axes each of them carries 1/√2 of the centripetal force ω² arm, and up to 1 g.
    usable_force = math.sqrt(2.0) * max(0.0, ranges.accel.value - STANDARD_GRAVITY)
    gravity = {arm: max(gyro_speed, wheel_radius * math.sqrt(usable_force / arm)) for arm in LISTED_ARMS}
    return MountingSpeed(name, gyro_speed, gravity)
