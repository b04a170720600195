"""Odometry and GNSS fixes to where the vehicle is on the map, live and in playback: ROS REP 105, map → odom.

What comes out depends on the poses and fixes and their order alone. A log, in which both stand in the order
in which the recorder took them, gives the same bits again.
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
from hubodo.fuse.graph.live import LiveGraph, LiveState
from hubodo.fuse.projection import LocalFrame
from hubodo.fuse.wheel.odometry_inflation import odometry_inflation
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.track import track_from_poses
from hubodo.ingest.sink import Sink
from hubodo.log import topics
from hubodo.log.timebase import to_seconds
from hubodo.units import NS_PER_S

_STEP = 1.0
"""m ahead of the vehicle at which a second point shows its heading in another frame."""


@dataclass(frozen=True, slots=True)
class FixSample:
    """A GNSS fix.

    t_ns: on the host's clock. sigma: m of each horizontal direction, None where the receiver did not say.
    """

    t_ns: int
    latitude_deg: float
    longitude_deg: float
    sigma: float | None


def horizontal_sigma(east: float, north: float) -> float:
    """1 sigma, m, of variances in east and north, m²."""
    return math.sqrt(0.5 * (east + north))


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Where the vehicle is on the map.

    Rows of /odom_map, each (1, ...) in form as those of `OdometryRows`, and where /odom's own frame lies on
    the map: odom_position (1, 2) m, odom_heading (1,) rad. x east, y north of origin_deg (latitude,
    longitude).
    """

    t_ns: NDArray[np.int64]
    position: Array
    heading: Array
    speed: Array
    yaw_rate: Array
    pose_covariance: Array
    odom_position: Array
    odom_heading: Array
    origin_deg: tuple[float, float]

    def write(self, sink: Sink, t_log_ns: int) -> None:
        """On /odom_map and, as map → odom, on /tf."""
        sink.write_odometry(
            self.t_ns,
            t_log_ns,
            self.position,
            self.heading,
            self.speed,
            self.yaw_rate,
            pose_covariance=self.pose_covariance,
            topic=topics.ODOM_MAP,
            frame="map",
        )
        sink.write_transform(
            self.t_ns, t_log_ns, self.odom_position, self.odom_heading, frame="map", child_frame="odom"
        )


Antenna = tuple[float, float]


class Localizer:
    """The factor graph over a window of the last minute, with a map frame that stays: that of its start."""

    def __init__(self, t_zero_ns: int, antenna: Antenna | None = None) -> None:
        """t_zero_ns: host time of t = 0 of the poses. antenna: m forward and left of the body origin."""
        self._t_zero_ns = t_zero_ns
        self._antenna = antenna
        self._graph = LiveGraph(GraphConfig(antenna=antenna or (0.0, 0.0)))
        self._map: LocalFrame | None = None
        self._said: set[str] = set()
        self._heard = 0
        self._pose: Pose | None = None

    def successor(self) -> Localizer:
        """Return a localizer without a past, in the same map frame."""
        successor = Localizer(self._t_zero_ns, self._antenna)
        successor._map, successor._said = self._map, set(self._said)
        return successor

    def fix(self, fix: FixSample) -> None:
        """A GNSS fix; those older than the newest pose of the graph are too late and left out."""
        t = float(to_seconds(np.array([fix.t_ns]), self._t_zero_ns)[0])
        self._graph.add_fix(t, fix.latitude_deg, fix.longitude_deg, fix.sigma)

    def odometry(self, pose: Pose) -> Located | None:
        """A pose of the wheel filter, at the end of a window; None while the heading is not known."""
        loose = (
            0.0 if self._pose is None else float(odometry_inflation(track_from_poses([self._pose, pose]))[0])
        )
        self._pose = pose
        self._graph.add_odometry(pose.t, pose.x, pose.y, pose.heading, loose)
        state = self._graph.state()
        if state is None or state.t != pose.t:
            return None
        x, y, heading = self._on_map(state)
        self._map = self._map or state.frame
        turn = heading - pose.heading
        moved = cmath.exp(1j * turn) * complex(pose.x, pose.y)
        return Located(
            np.array([self._t_zero_ns + round(pose.t * NS_PER_S)], np.int64),
            np.array([[x, y]]),
            np.array([heading]),
            np.array([pose.speed]),
            np.array([pose.yaw_rate]),
            state.covariance[None],
            np.array([[x - moved.real, y - moved.imag]]),
            np.array([math.remainder(turn, 2.0 * math.pi)]),
            (self._map.latitude_deg, self._map.longitude_deg),
        )

    def warnings(self) -> list[str]:
        """What a user must know and has not been told yet."""
        new, self._heard = self._graph.warnings[self._heard :], len(self._graph.warnings)
        lines = []
        for line in new:
            # A start that fails is tried again every few seconds, for the same reason.
            kind = re.sub(r"\d+(\.\d+)?", "#", line) if "no usable fix" in line else line
            if kind not in self._said:
                self._said.add(kind)
                lines.append(line)
        return lines

    def _on_map(self, state: LiveState) -> tuple[float, float, float]:
        """x, y, heading of a state, which after a new start of the graph stands in another frame."""
        if self._map is None or state.frame == self._map:
            return state.x, state.y, state.heading
        ahead = complex(state.x, state.y) + _STEP * cmath.exp(1j * state.heading)
        latitude, longitude = state.frame.to_geodetic(
            np.array([state.x, ahead.real]), np.array([state.y, ahead.imag])
        )
        x, y = self._map.to_local(latitude, longitude)
        heading = math.atan2(y[1] - y[0], x[1] - x[0])
        heading += 2.0 * math.pi * round((state.heading - heading) / (2.0 * math.pi))
        return float(x[0]), float(y[0]), heading
