"""Localisation on the map from odometry and GNSS fixes, live and in playback (ROS REP 105, map → odom).

The result depends only on the poses and fixes and their order. A log holds both in the order in which the
recorder processed them, so playback reproduces the result bit by bit.
"""

from __future__ import annotations

import cmath
import math
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.constants import sigmas_for_wheel_filter
from hubodo.fuse.graph.live import LiveGraph, LiveState
from hubodo.fuse.projection import LocalFrame
from hubodo.fuse.wheel.config import RADIUS_SIGMAS
from hubodo.fuse.wheel.entries import GYRO_SCALE_ACROSS, YAW_RATE_FROM_GRAVITY
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.track import track_from_poses
from hubodo.ingest.live.odometry_rows import OdometryRows
from hubodo.log import topics
from hubodo.log.records import Sink, Transform
from hubodo.log.timebase import to_seconds
from hubodo.units import NS_PER_S
from hubodo.vehicle import Vehicle

_HEADING_BASELINE_M = 1.0
"""Distance ahead of the vehicle of a second point that gives its heading in another frame."""


@dataclass(frozen=True, slots=True)
class FixSample:
    """A GNSS fix; t_ns: host time; sigma: standard deviation of each horizontal axis, m, None if unknown."""

    t_ns: int
    latitude_deg: float
    longitude_deg: float
    sigma: float | None


def horizontal_sigma(east: float, north: float) -> float:
    """Return the standard deviation per horizontal axis, m, from variances in east and north, m²."""
    return math.sqrt(0.5 * (east + north))


@dataclass(frozen=True, slots=True, eq=False)
class MapPose:
    """Pose of the vehicle on the map: x east, y north of the origin.

    Attributes
    ----------
    row
        One row of /odom_map.
    odom_position, odom_heading
        Pose of the odom frame on the map: (1, 2) m and (1,) rad.
    origin_deg
        Latitude and longitude of the map's origin.
    """

    row: OdometryRows
    odom_position: Array
    odom_heading: Array
    origin_deg: tuple[float, float]

    @property
    def t_ns(self) -> NDArray[np.int64]:
        """Return the host time, (1,)."""
        return self.row.t_ns

    def write(self, sink: Sink, t_log_ns: int) -> None:
        """Write the pose on /odom_map and the transform map → odom on /tf."""
        sink.write_record(self.row.to_record(t_log_ns, topics.ODOM_MAP, "map"))
        transform = Transform(self.t_ns, t_log_ns, self.odom_position, self.odom_heading, "map", "odom")
        sink.write_record(transform)


class Localizer:
    """A factor graph over the last minute, in the map frame of its start."""

    def __init__(self, t_zero_ns: int, vehicle: Vehicle | None = None) -> None:
        """Start without a map.

        t_zero_ns: host time of t = 0; vehicle: provides the antenna and how the wheel radius was determined.
        """
        self._t_zero_ns = t_zero_ns
        self._vehicle = vehicle
        radius_sigma = RADIUS_SIGMAS[vehicle.radius_from if vehicle is not None else "nominal"].total
        constants = sigmas_for_wheel_filter(
            radius_sigma, [GYRO_SCALE_ACROSS.prior], YAW_RATE_FROM_GRAVITY.prior
        )
        antenna = (vehicle.antenna if vehicle is not None else None) or (0.0, 0.0)
        self._graph = LiveGraph(GraphConfig(antenna=antenna, constants=constants))
        self._map: LocalFrame | None = None
        self._reported_kinds: set[str] = set()
        self._warnings_read = 0
        self._pose: Pose | None = None

    def successor(self) -> Localizer:
        """Return a localizer without history, in the same map frame."""
        successor = Localizer(self._t_zero_ns, self._vehicle)
        successor._map, successor._reported_kinds = self._map, set(self._reported_kinds)
        return successor

    def add_fix(self, fix: FixSample) -> None:
        """Add a GNSS fix; a fix older than the newest pose of the graph is ignored."""
        t = float(to_seconds(np.array([fix.t_ns]), self._t_zero_ns)[0])
        self._graph.add_fix(t, fix.latitude_deg, fix.longitude_deg, fix.sigma)

    def add_pose(self, pose: Pose) -> MapPose | None:
        """Add a pose of the wheel filter; return the pose on the map, None while the heading is unknown."""
        inflation = (
            0.0 if self._pose is None else float(track_from_poses([self._pose, pose]).step_inflation[0])
        )
        self._pose = pose
        self._graph.add_odometry(pose.t, pose.x, pose.y, pose.heading, inflation)
        state = self._graph.state()
        if state is None or state.t != pose.t:
            return None
        x, y, heading = self._to_map_frame(state)
        self._map = self._map or state.frame
        # A correction that /odom has not followed yet belongs to map → odom.
        odom_x, odom_y, odom_heading = pose.published or (pose.x, pose.y, pose.heading)
        rotation = heading - odom_heading
        rotated = cmath.exp(1j * rotation) * complex(odom_x, odom_y)
        row = OdometryRows(
            np.array([self._t_zero_ns + round(pose.t * NS_PER_S)], np.int64),
            np.array([[x, y]]),
            np.array([heading]),
            np.array([pose.speed]),
            np.array([pose.yaw_rate]),
            state.covariance[None],
        )
        return MapPose(
            row,
            np.array([[x - rotated.real, y - rotated.imag]]),
            np.array([math.remainder(rotation, 2.0 * math.pi)]),
            (self._map.latitude_deg, self._map.longitude_deg),
        )

    def warnings(self) -> list[str]:
        """Return the warnings that were not reported yet."""
        new, self._warnings_read = self._graph.warnings[self._warnings_read :], len(self._graph.warnings)
        lines = []
        for line in new:
            # An initialisation that fails is retried every few seconds with the same warning.
            kind = re.sub(r"\d+(\.\d+)?", "#", line) if "no usable fix" in line else line
            if kind not in self._reported_kinds:
                self._reported_kinds.add(kind)
                lines.append(line)
        return lines

    def _to_map_frame(self, state: LiveState) -> tuple[float, float, float]:
        """Return x, y, heading on the map; after a reset of the graph its state is in another frame."""
        if self._map is None or state.frame == self._map:
            return state.x, state.y, state.heading
        ahead = complex(state.x, state.y) + _HEADING_BASELINE_M * cmath.exp(1j * state.heading)
        latitude, longitude = state.frame.to_geodetic(
            np.array([state.x, ahead.real]), np.array([state.y, ahead.imag])
        )
        x, y = self._map.to_local(latitude, longitude)
        heading = math.atan2(y[1] - y[0], x[1] - x[0])
        heading += 2.0 * math.pi * round((state.heading - heading) / (2.0 * math.pi))
        return float(x[0]), float(y[0]), heading
