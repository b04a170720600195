"""Rows of odometry that the recorder publishes: /odom, and one at a time /odom_map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.wheel.records import Pose
from hubodo.log import topics
from hubodo.log.records import Odometry, Sink, Transform


@dataclass(frozen=True, slots=True, eq=False)
class OdometryRows:
    """Rows of odometry.

    t_ns: (N,) host time; position: (N, 2) m; heading: (N,) rad; speed: (N,) m/s; yaw_rate: (N,) rad/s;
    pose_covariance: (N, 3, 3) of x, y, heading; twist_covariance: (N, 2, 2) of speed, yaw rate, or None.
    """

    t_ns: NDArray[np.int64]
    position: Array
    heading: Array
    speed: Array
    yaw_rate: Array
    pose_covariance: Array
    twist_covariance: Array | None = None

    @classmethod
    def from_states(cls, t_ns: Sequence[int], states: Sequence[Pose]) -> OdometryRows:
        """Return the rows of N states of the filter; t_ns: their host times."""
        covariance = np.array([state.covariance for state in states])
        return cls(
            np.array(t_ns, np.int64),
            np.array([(state.x, state.y) for state in states]),
            np.array([state.heading for state in states]),
            np.array([state.speed for state in states]),
            np.array([state.yaw_rate for state in states]),
            covariance[:, :3, :3],
            covariance[:, 3:, 3:],
        )

    def to_record(self, t_log_ns: int, topic: str = topics.ODOM, frame: str = "odom") -> Odometry:
        """Return the rows as a record of the log."""
        return Odometry(
            self.t_ns,
            t_log_ns,
            self.position,
            self.heading,
            self.speed,
            self.yaw_rate,
            self.pose_covariance,
            self.twist_covariance,
            topic,
            frame,
        )

    def write(self, sink: Sink, t_log_ns: int) -> None:
        """Write the rows on /odom and /tf."""
        sink.write_record(self.to_record(t_log_ns))
        sink.write_record(Transform(self.t_ns, t_log_ns, self.position, self.heading))
