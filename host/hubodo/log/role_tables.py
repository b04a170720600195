"""The files of the CSV folder from the messages that play their roles: positions, speeds, headings, truth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log import ros2
from hubodo.log.decode import ChannelRows
from hubodo.log.joints import JointSpeeds

FloatArray = NDArray[np.float64]
Columns = dict[str, FloatArray]


def position(fix: ChannelRows) -> Columns:
    """Columns of gnss."""
    return {
        "latitude_deg": fix.values["latitude"],
        "longitude_deg": fix.values["longitude"],
        "altitude": fix.values["altitude"],
    }


def gnss(fix: ChannelRows) -> tuple[ChannelRows, Columns]:
    """Rows with a fix, and their columns; sigma where each tells its covariance."""
    known = np.isfinite(np.column_stack(list(position(fix).values()))).all(axis=1)
    fix = fix.take(np.flatnonzero(known & (fix.values["status.status"] >= 0)))
    columns = position(fix)
    horizontal = fix.values["position_covariance"][:, [0, 4]].mean(axis=1)
    if len(fix) and (fix.values["position_covariance_type"] > 0).all() and (horizontal >= 0).all():
        columns["sigma"] = np.sqrt(horizontal)
    return fix, columns


def reference(kind: str, rows: ChannelRows) -> Columns:
    """speed, yaw_rate of the vehicle's own frame: x forward, z up (REP 103)."""
    prefix = "twist" if kind == ros2.TWIST_STAMPED else "twist.twist"
    return {
        "speed": rows.values[prefix + ".linear"][:, 0],
        "yaw_rate": rows.values[prefix + ".angular"][:, 2],
    }


def truth(rows: ChannelRows) -> Columns:
    """x, y, and the heading unless its variance says that it is not known."""
    place = rows.values["pose.pose.position"]
    made = {"x": place[:, 0], "y": place[:, 1]}
    if not (rows.values["pose.covariance"][:, 35] >= ros2.UNKNOWN_VARIANCE).any():
        made["heading"] = yaw(rows.values["pose.pose.orientation"])
    return made


def odometry(rows: ChannelRows) -> Columns:
    """A pose and the motion that goes with it."""
    place = rows.values["pose.pose.position"]
    heading = yaw(rows.values["pose.pose.orientation"])
    return {"x": place[:, 0], "y": place[:, 1], "heading": heading, **reference(ros2.ODOMETRY, rows)}


def heading(kind: str, rows: ChannelRows, topic: str) -> Columns:
    """heading anticlockwise from east, which REP 103 and 145 make the yaw of an orientation; sigma if told.

    Raises InputError where an IMU says that it has no orientation.
    """
    if kind == ros2.ODOMETRY:
        made = {"heading": yaw(rows.values["pose.pose.orientation"])}
        variance = rows.values["pose.covariance"][:, 35]
    else:
        if (rows.values["orientation_covariance"][:, 0] == -1).any():
            raise InputError(
                f"{topic}: says that it has no orientation (covariance -1); name another heading"
            )
        made = {"heading": yaw(rows.values["orientation"])}
        variance = rows.values["orientation_covariance"][:, 8]
    if (variance > 0).all():
        made["sigma"] = np.sqrt(variance)
    return made


def yaw(turn: FloatArray) -> FloatArray:
    """(N,) rad, unwrapped, of quaternions (N, 4) x, y, z, w."""
    x, y, z, w = turn.T
    if x.any() or y.any():
        made: FloatArray = np.unwrap(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))
    else:
        made = np.unwrap(2 * np.arctan2(z, w))
    return made


def wheels(
    speeds: JointSpeeds, joints: tuple[str, str], radius: float
) -> tuple[NDArray[np.int64], Mapping[str, FloatArray]]:
    """Times in ns and the surface speeds, m/s, left and right; right laid onto the times of left."""
    t_ns, left = speeds.table(joints[0])
    other_ns, right = speeds.table(joints[1])
    if not len(t_ns) or not len(other_ns):
        return t_ns[:0], {"left": left[:0], "right": right[:0]}
    both = (t_ns >= other_ns[0]) & (t_ns <= other_ns[-1])
    t_ns, left = t_ns[both], left[both]
    # Differences of ns, which float64 holds; times since 1970 it does not.
    onto = np.interp((t_ns - other_ns[0]).astype(float), (other_ns - other_ns[0]).astype(float), right)
    return t_ns, {"left": radius * left, "right": radius * onto}
