"""Where a vehicle's sensors sit, as transforms from base_link: what /tf_static says."""

from __future__ import annotations

from dataclasses import dataclass

from hubodo.vehicle import Vehicle, side_sign


@dataclass(frozen=True)
class PlacedFrame:
    """A frame in base_link. position: m; turn: quaternion x, y, z, w, of its vectors to base_link's."""

    name: str
    position: tuple[float, float, float]
    turn: tuple[float, float, float, float]


_AS_BODY = (0.0, 0.0, 0.0, 1.0)
# x up, y forward, z left; and x up, y backward, z right: a wheel's node at wheel angle 0.
_FACING = {"left": (-0.5, -0.5, -0.5, 0.5), "right": (0.5, -0.5, 0.5, 0.5)}
GNSS = "gnss"


def placed(vehicle: Vehicle) -> list[PlacedFrame]:
    """The nodes, those on wheels at their hubs at wheel angle 0, and the antenna where it is known.

    base_link is on the ground midway between the wheels, x forward, y left, z up (REP 103).
    """
    frames = []
    for name, mount in vehicle.nodes.items():
        if mount.side is None or mount.facing is None:
            frames.append(PlacedFrame(name, (0.0, 0.0, 0.0), _AS_BODY))
        else:
            aside = side_sign(mount.side) * vehicle.track_width / 2
            frames.append(PlacedFrame(name, (0.0, aside, vehicle.wheel_radius), _FACING[mount.facing]))
    if vehicle.antenna is not None:
        frames.append(PlacedFrame(GNSS, (*vehicle.antenna, 0.0), _AS_BODY))
    return frames
