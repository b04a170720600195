"""Convert messages to the columns of their role: GNSS, reference, wheels, heading, truth, odometry."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log import ros2
from hubodo.log.decode import ChannelRows
from hubodo.log.joints import JointSpeeds

Columns = dict[str, Array]


def position_columns(fix: ChannelRows) -> Columns:
    """Return latitude, longitude (degrees) and altitude (m) of the fixes."""
    return {
        "latitude_deg": fix.values["latitude"],
        "longitude_deg": fix.values["longitude"],
        "altitude": fix.values["altitude"],
    }


def gnss_columns(fix: ChannelRows) -> tuple[ChannelRows, Columns]:
    """Return the rows with a fix and their columns, with sigma (m) if every row has a covariance."""
    has_position = np.isfinite(np.column_stack(list(position_columns(fix).values()))).all(axis=1)
    fix = fix.select(np.flatnonzero(has_position & (fix.values["status.status"] >= 0)))
    columns = position_columns(fix)
    horizontal = fix.values["position_covariance"][:, [0, 4]].mean(axis=1)
    if len(fix) and (fix.values["position_covariance_type"] > 0).all() and (horizontal >= 0).all():
        columns["sigma"] = np.sqrt(horizontal)
    return fix, columns


def reference_columns(kind: str, rows: ChannelRows) -> Columns:
    """Return speed (m/s) and yaw_rate (rad/s) in the vehicle frame, x forward, z up (REP 103)."""
    prefix = "twist" if kind == ros2.TWIST_STAMPED else "twist.twist"
    return {
        "speed": rows.values[prefix + ".linear"][:, 0],
        "yaw_rate": rows.values[prefix + ".angular"][:, 2],
    }


def truth_columns(rows: ChannelRows) -> Columns:
    """Return x, y (m) and, unless its variance marks it as unknown, heading (rad)."""
    position = rows.values["pose.pose.position"]
    columns = {"x": position[:, 0], "y": position[:, 1]}
    if not (rows.values["pose.covariance"][:, 35] >= ros2.UNKNOWN_VARIANCE).any():
        columns["heading"] = yaw_of_quaternions(rows.values["pose.pose.orientation"])
    return columns


def odometry_columns(rows: ChannelRows) -> Columns:
    """Return x, y, heading, speed and yaw_rate of odometry messages."""
    position = rows.values["pose.pose.position"]
    heading = yaw_of_quaternions(rows.values["pose.pose.orientation"])
    return {
        "x": position[:, 0],
        "y": position[:, 1],
        "heading": heading,
        **reference_columns(ros2.ODOMETRY, rows),
    }


def heading_columns(kind: str, rows: ChannelRows, topic: str) -> Columns:
    """Return heading (rad, anticlockwise from east: the yaw of REP 103 and 145), with sigma if stated.

    Raises InputError if an IMU declares that it has no orientation.
    """
    if kind == ros2.ODOMETRY:
        columns = {"heading": yaw_of_quaternions(rows.values["pose.pose.orientation"])}
        variance = rows.values["pose.covariance"][:, 35]
    else:
        if (rows.values["orientation_covariance"][:, 0] == -1).any():
            raise InputError(
                f"{topic}: declares that it has no orientation (covariance -1); select another heading"
            )
        columns = {"heading": yaw_of_quaternions(rows.values["orientation"])}
        variance = rows.values["orientation_covariance"][:, 8]
    if (variance > 0).all():
        columns["sigma"] = np.sqrt(variance)
    return columns


def yaw_of_quaternions(quaternions: Array) -> Array:
    """Return the unwrapped yaw (N,) in rad of quaternions (N, 4) in the order x, y, z, w."""
    x, y, z, w = quaternions.T
    if x.any() or y.any():
        yaw: Array = np.unwrap(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))
    else:
        yaw = np.unwrap(2 * np.arctan2(z, w))
    return yaw


def wheel_speed_columns(
    speeds: JointSpeeds, joints: tuple[str, str], radius: float
) -> tuple[NDArray[np.int64], Mapping[str, Array]]:
    """Return times (ns) and wheel surface speeds (m/s); right is interpolated at the times of left."""
    t_ns, left = speeds.velocity(joints[0])
    right_ns, right = speeds.velocity(joints[1])
    if not len(t_ns) or not len(right_ns):
        return t_ns[:0], {"left": left[:0], "right": right[:0]}
    overlap = (t_ns >= right_ns[0]) & (t_ns <= right_ns[-1])
    t_ns, left = t_ns[overlap], left[overlap]
    # float64 holds differences in ns exactly, but not times since 1970.
    right_resampled = np.interp(
        (t_ns - right_ns[0]).astype(float), (right_ns - right_ns[0]).astype(float), right
    )
    return t_ns, {"left": radius * left, "right": radius * right_resampled}
