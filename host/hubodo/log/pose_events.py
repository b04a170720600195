"""Events about poses that other programs set during a recording: written, and read for playback."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple, TypeGuard

from hubodo.recording import Event

_KIND, _SOURCE = "pose", "odometry"


class LoggedPose(NamedTuple):
    """A pose set at a time: x, y, heading in m, m, rad; covariance: (3, 3) of them."""

    t_ns: int
    pose: tuple[float, float, float]
    covariance: list[list[float]]


def pose_event(
    t_ns: int, requester: str, pose: tuple[float, float, float], covariance: list[list[float]]
) -> Event:
    """Return the event about a pose; t_ns: its log time, unique among samples."""
    x, y, heading = pose
    text = f"pose set to {x:.3f} m, {y:.3f} m, {math.degrees(heading):.1f}° by {requester}"
    return Event(t_ns, _KIND, _SOURCE, text, {"pose": list(pose), "covariance": covariance})


def read_poses(events: Iterable[Event]) -> list[LoggedPose]:
    """Return the poses that were set; events of other kinds, and such that are incomplete, are left out."""
    poses = []
    for event in events:
        if (event.kind, event.source) == (_KIND, _SOURCE):
            pose, rows = event.data.get("pose"), event.data.get("covariance")
            if _is_vector(pose) and isinstance(rows, list) and len(rows) == 3 and all(map(_is_vector, rows)):
                poses.append(LoggedPose(event.t_ns, (pose[0], pose[1], pose[2]), rows))
    return poses


def _is_vector(values: object) -> TypeGuard[list[float]]:
    """Return True for three finite numbers."""
    return (
        isinstance(values, list)
        and len(values) == 3
        and all(isinstance(value, float | int) and math.isfinite(value) for value in values)
    )
