"""The odometry of a recording as MAVLink over UDP, for rovers with ArduPilot or PX4."""

from __future__ import annotations

import math
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from hubodo.errors import InputError
from hubodo.extras import require_extra
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.output_thread import OutputThread
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.tee_sink import RecordListener
from hubodo.log import topics
from hubodo.log.records import LogRecord, Odometry
from hubodo.log.ros2 import UNKNOWN_VARIANCE
from hubodo.units import NS_PER_S
from hubodo.vehicle import Vehicle

_SCHEME = "udpout:"
_SEND_INTERVAL_NS = NS_PER_S // 50
"""Between two messages of odometry; autopilots use 20 to 50 per second."""
_MAX_QUEUED_POSES = 512
_SYSTEM_ID = 1
"""System id of the vehicle, the default of autopilots; the component id identifies this program."""
_FORWARD_RIGHT_DOWN = np.array([1.0, -1.0, -1.0])
"""Signs of x, y and heading from forward, left, up to the axes of MAVLink."""


class MavlinkOutput:
    """A `RecordOutput` that sends HEARTBEAT, ODOMETRY and WHEEL_DISTANCE from its own thread.

    Wheel distances are those of the left and the right contact point, from speed and yaw rate.
    """

    def __init__(self, address: tuple[str, int], vehicle: Vehicle) -> None:
        """Send to this address; raise InputError if it cannot be resolved."""
        from pymavlink.dialects.v20 import common

        self._dialect = common
        self._half_track = 0.5 * vehicle.track_width
        try:
            family, _, _, _, peer = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise InputError(f"--mavlink {_SCHEME}{address[0]}:{address[1]}: {error.strerror}") from None
        self._peer: Any = peer
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._link: Any = common.MAVLink(
            self, srcSystem=_SYSTEM_ID, srcComponent=common.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
        )
        self._distance = np.zeros(2)  # of the left and right wheel, m
        self._newest_ns: int | None = None
        self._sent_ns = 0
        self._thread: OutputThread[Odometry | Snapshot] | None = None

    def attach(self, bulkheads: Bulkheads) -> RecordListener:
        """Start the thread; see `RecordOutput`."""
        self._thread = OutputThread("mavlink", lambda: self._send, bulkheads, capacity=_MAX_QUEUED_POSES)
        return self._queue

    def show(self, snapshot: Snapshot) -> None:
        """Queue a heartbeat; see `RecordOutput`."""
        if self._thread is not None:
            self._thread.put(snapshot)

    def close(self) -> None:
        """Send what is queued and release the socket."""
        if self._thread is not None:
            self._thread.close()
        self._socket.close()

    def write(self, data: bytes) -> None:
        """Send one message, for pymavlink; where nobody listens it is lost."""
        try:
            self._socket.sendto(data, self._peer)
        except (BlockingIOError, ConnectionRefusedError):
            return

    def _queue(self, record: LogRecord) -> None:
        if self._thread is not None and isinstance(record, Odometry) and record.topic == topics.ODOM:
            self._thread.put(record)

    def _send(self, item: Odometry | Snapshot) -> None:
        if isinstance(item, Snapshot):
            kind, autopilot = self._dialect.MAV_TYPE_ONBOARD_CONTROLLER, self._dialect.MAV_AUTOPILOT_INVALID
            self._link.heartbeat_send(kind, autopilot, 0, 0, self._dialect.MAV_STATE_ACTIVE)
            return
        self._add_distance(item)
        t_ns = int(item.t_ns[-1])
        if t_ns - self._sent_ns >= _SEND_INTERVAL_NS:
            self._sent_ns = t_ns
            self._send_odometry(item, t_ns // 1000)
            distances = [*self._distance.tolist(), *[0.0] * 14]
            self._link.wheel_distance_send(t_ns // 1000, 2, distances)

    def _add_distance(self, odometry: Odometry) -> None:
        """Add the distance since the previous row; speeds are means over the time to the row before."""
        before_ns = int(odometry.t_ns[0]) if self._newest_ns is None else self._newest_ns
        steps = np.diff(odometry.t_ns, prepend=before_ns) / NS_PER_S
        turn = self._half_track * odometry.yaw_rate
        self._distance += steps @ np.column_stack([odometry.speed - turn, odometry.speed + turn])
        self._newest_ns = int(odometry.t_ns[-1])

    def _send_odometry(self, odometry: Odometry, t_us: int) -> None:
        dialect, heading = self._dialect, -float(odometry.heading[-1])
        x, y = odometry.position[-1].tolist()
        self._link.odometry_send(
            t_us,
            dialect.MAV_FRAME_LOCAL_FRD,
            dialect.MAV_FRAME_BODY_FRD,
            x,
            -y,
            0.0,
            [math.cos(0.5 * heading), 0.0, 0.0, math.sin(0.5 * heading)],
            float(odometry.speed[-1]),
            0.0,
            0.0,
            0.0,
            0.0,
            -float(odometry.yaw_rate[-1]),
            _pack_covariance(odometry.pose_covariance, [0, 1, 5], _FORWARD_RIGHT_DOWN),
            _pack_covariance(odometry.twist_covariance, [0, 5], _FORWARD_RIGHT_DOWN[[0, 2]]),
            estimator_type=dialect.MAV_ESTIMATOR_TYPE_UNKNOWN,
        )


def parse_mavlink_address(text: str) -> tuple[str, int]:
    """Return host and port number of `udpout:HOST:PORT`; raise InputError for anything else."""
    host, _, number = text.removeprefix(_SCHEME).rpartition(":")
    if not text.startswith(_SCHEME) or not host or not number.isdecimal() or not 0 < int(number) < 65536:
        raise InputError(f"--mavlink {text!r}: write udpout:HOST:PORT, such as udpout:127.0.0.1:14550")
    return host, int(number)


@contextmanager
def mavlink_output(text: str, vehicle: Vehicle | None) -> Iterator[MavlinkOutput]:
    """Provide the output to `udpout:HOST:PORT`; raise InputError without a vehicle (no odometry to send)."""
    address = parse_mavlink_address(text)
    if vehicle is None:
        raise InputError("--mavlink sends the odometry, which needs --vehicle")
    require_extra("mavlink", "MAVLink")
    output = MavlinkOutput(address, vehicle)
    try:
        yield output
    finally:
        output.close()


def _pack_covariance(measured: Any, rows: list[int], signs: Any) -> list[float]:
    """Return the upper triangle of a 6 x 6 covariance, row by row; unmeasured variances are large."""
    full = np.diag(np.full(6, UNKNOWN_VARIANCE))
    if measured is None:
        full[0, 0] = np.nan  # unknown, by the definition of the message
    else:
        full[np.ix_(rows, rows)] = measured[-1] * np.outer(signs, signs)
    upper: list[float] = full[np.triu_indices(6)].tolist()
    return upper
