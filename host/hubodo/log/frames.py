"""Transforms from base_link to the frames of a vehicle's sensors, for /tf_static."""

from __future__ import annotations

from dataclasses import dataclass

from hubodo.vehicle import Vehicle, side_sign


@dataclass(frozen=True)
class SensorFrame:
    """A sensor frame: position in base_link, m; rotation base_link from sensor, quaternion (x, y, z, w)."""

    name: str
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


_IDENTITY_QUATERNION = (0.0, 0.0, 0.0, 1.0)
# Rotations base_link from node at wheel angle 0. A node that faces left has x up, y forward, z left; one that
# faces right has x up, y backward, z right.
_FACING_QUATERNIONS = {"left": (-0.5, -0.5, -0.5, 0.5), "right": (0.5, -0.5, 0.5, 0.5)}
GNSS_FRAME = "gnss"


def sensor_frames(vehicle: Vehicle) -> list[SensorFrame]:
    """Return the frames of the nodes (on wheels: at the hub, wheel angle 0) and of the antenna if known.

    base_link is on the ground midway between the wheels, x forward, y left, z up (REP 103).
    """
    frames = []
    for name, mount in vehicle.nodes.items():
        if mount.side is None or mount.facing is None:
            frames.append(SensorFrame(name, (0.0, 0.0, 0.0), _IDENTITY_QUATERNION))
        else:
            lateral = side_sign(mount.side) * vehicle.track_width / 2
            frames.append(
                SensorFrame(name, (0.0, lateral, vehicle.wheel_radius), _FACING_QUATERNIONS[mount.facing])
            )
    if vehicle.antenna is not None:
        frames.append(SensorFrame(GNSS_FRAME, (*vehicle.antenna, 0.0), _IDENTITY_QUATERNION))
    return frames
