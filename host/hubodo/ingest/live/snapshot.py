"""Immutable snapshot of the state of a recording: its links, nodes, receivers, odometry and log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hubodo.units import NS_PER_S


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """Status of a link; counters are totals since the start.

    where: name of the open device or address, None while the link is down. faults: unexpected exceptions
    of the port's driver. refused: datagrams without a valid key, and frames of nodes beyond the limit.
    senders_evicted: senders dropped before identification.
    """

    label: str
    where: str | None
    frames: int
    bytes: int
    crc_errors: int
    frames_damaged: int
    disconnections: int
    foreign: str | None
    faults: int = 0
    refused: int = 0
    senders_evicted: int = 0


@dataclass(frozen=True, slots=True)
class NodeStatus:
    """Status of a node.

    rate: samples per second over the last two seconds. age: time since its last frame, s. clock_offset,
    clock_sigma: s, clock_drift: dimensionless; clock_sigma is None while unknown. gyro, accel: means (3,) of
    the newest block, rad/s and m/s², node axes. bias: (3,) rad/s by the node's own filter, None before its
    first report. temperature: °C. battery: V. asleep: True if the newest health report says that the node is
    parked and waits for motion.
    """

    name: str
    link: str
    node_id: int
    rate: float
    age: float
    frames: int
    frames_lost: int
    samples: int
    samples_lost: int
    restarts: int
    clock_offset: float
    clock_drift: float
    clock_sigma: float | None
    temperature: float | None
    battery: float | None
    bias: tuple[float, float, float] | None
    gyro: tuple[float, float, float] | None
    accel: tuple[float, float, float] | None
    refused: str | None
    asleep: bool = False


@dataclass(frozen=True, slots=True)
class GnssStatus:
    """Status of a GNSS receiver; latitude_deg, longitude_deg: last fix, None before the first."""

    label: str
    fixes: int
    checksum_errors: int
    latitude_deg: float | None
    longitude_deg: float | None


@dataclass(frozen=True, slots=True)
class OdometryStatus:
    """Newest state of the odometry.

    x, y: m; heading: rad; speed: m/s; yaw_rate: rad/s. sigma: 1 sigma along the major axis of the position
    ellipse, m. distance: path since the start, m. poses: number of poses.
    """

    x: float
    y: float
    heading: float
    speed: float
    yaw_rate: float
    sigma: float
    distance: float
    poses: int


@dataclass(frozen=True, slots=True)
class LogStatus:
    """Status of the log.

    path: the open log, else the last one; size: its bytes; total: bytes of all logs since the start.
    recording: True while data is written; trouble: cause of an interruption, or of the early end of a log.
    logs: number of logs started; messages_lost: messages contained in no log; disk_free, disk_size: bytes,
    None while the folder is missing.
    """

    path: Path
    size: int
    total: int
    messages: int
    recording: bool
    trouble: str | None
    logs: int
    messages_lost: int
    disk_free: int | None
    disk_size: int | None


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Status of a recording at host time t_ns.

    started_ns: host time of the start. memory: resident bytes of the process. map: position on the map,
    (x east, y north) m, None while unknown. faults: number of exceptions and hangs by part.
    """

    t_ns: int
    started_ns: int
    log: LogStatus
    links: tuple[LinkStatus, ...]
    nodes: tuple[NodeStatus, ...]
    gnss: tuple[GnssStatus, ...]
    odometry: OdometryStatus | None
    map: tuple[float, float] | None
    memory: int | None
    faults: Mapping[str, int]

    @property
    def seconds(self) -> float:
        """Time since the start, s."""
        return (self.t_ns - self.started_ns) / NS_PER_S
