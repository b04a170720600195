"""Immutable snapshots of the state of a recording, and their publication once per second."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.link.session import LinkSession
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.tee_sink import RecordListener
from hubodo.ingest.node.health import is_asleep
from hubodo.ingest.node.session import NodeSession
from hubodo.ingest.topic.handlers import FixHandler, ImuHandler
from hubodo.ingest.topic.session import TopicSession
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.recording import Event
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


SnapshotObserver = Callable[[Snapshot], Iterable[Event] | None]
"""Called with each snapshot in the recorder's thread; must return at once. Returned events are logged."""


class Audience(Protocol):
    """An observer with access to the recorder; called in the recorder's thread, so it must not block."""

    def attach(self, log: LogWriter, series: LogSeries, bulkheads: Bulkheads) -> Mapping[str, RecordListener]:
        """Return the listeners to all log records, by name of their part; called once before the start."""
        ...

    def poll(self, recorder: Recorder, now_ns: int) -> None:
        """Inspect the recorder; called about fifty times per second."""
        ...

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot; called once per second."""
        ...


class SnapshotPublisher:
    """Publishes a snapshot of the recorder once per second to observers, each behind its bulkhead."""

    def __init__(
        self,
        recorder: Recorder,
        log: Callable[[], LogStatus],
        watch: Mapping[str, SnapshotObserver],
        audience: Audience | None = None,
    ) -> None:
        """Start with these observers, by name of their part."""
        self._recorder, self._log, self._audience = recorder, log, audience
        self._observers = dict(watch)
        if audience is not None:
            self._observers["page"] = audience.show
        self._started_ns = self._next_ns = 0

    def add_observer(self, part: str, observer: SnapshotObserver) -> None:
        """Add an observer."""
        self._observers[part] = observer

    def tick(self, now_ns: int) -> None:
        """Publish a snapshot if one is due; the first call marks the start."""
        run = self._recorder.bulkheads.run
        if self._audience is not None:
            run("page", self._audience.poll, self._recorder, now_ns, pausing=True)
        if now_ns < self._next_ns or not self._observers:
            return
        self._started_ns = self._started_ns or now_ns
        self._next_ns = now_ns + NS_PER_S
        run("status", self._publish_snapshot, now_ns)

    def _publish_snapshot(self, now_ns: int) -> None:
        snapshot = take_snapshot(self._recorder, self._log(), self._started_ns, now_ns)
        for part, watch in self._observers.items():
            self._recorder.bulkheads.run(part, self._show_snapshot, watch, snapshot, pausing=True)

    def _show_snapshot(self, watch: SnapshotObserver, snapshot: Snapshot) -> None:
        for event in watch(snapshot) or ():
            self._recorder.report_event(event)


def take_snapshot(recorder: Recorder, log: LogStatus, started_ns: int, now_ns: int) -> Snapshot:
    """Return the present status; to be called in the recorder's thread."""
    located, topics = recorder.map.latest, list(recorder.topics.values())
    return Snapshot(
        now_ns,
        started_ns,
        log,
        (
            *(_link_status(link) for link in recorder.links.values()),
            *(_topic_link_status(topic) for topic in topics),
        ),
        (
            *(_node_status(node, now_ns) for node in recorder.nodes),
            *(
                _topic_node_status(topic, topic.handler, now_ns)
                for topic in topics
                if isinstance(topic.handler, ImuHandler)
            ),
        ),
        (
            *(
                GnssStatus(
                    label,
                    session.decoder.counts.fixes,
                    session.decoder.counts.checksum_errors,
                    session.last_fix.latitude_deg if session.last_fix is not None else None,
                    session.last_fix.longitude_deg if session.last_fix is not None else None,
                )
                for label, session in recorder.gnss.items()
            ),
            *(
                _topic_gnss_status(topic, topic.handler)
                for topic in topics
                if isinstance(topic.handler, FixHandler)
            ),
        ),
        _odometry_status(recorder),
        None if located is None else (float(located.position[0, 0]), float(located.position[0, 1])),
        memory_in_use(),
        recorder.bulkheads.fault_counts(),
    )


def memory_in_use() -> int | None:
    """Return the resident memory of the process, bytes; None where the system does not report it."""
    try:
        return int(Path("/proc/self/statm").read_bytes().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


def _link_status(link: LinkSession) -> LinkStatus:
    return LinkStatus(
        link.label,
        link.endpoint,
        link.frames,
        link.bytes,
        link.damage["crc"],
        sum(link.damage.values()),
        link.connection.disconnections,
        link.foreign,
        link.connection.faults,
        link.datagrams_refused + link.senders.frames_refused,
        link.senders.senders_evicted,
    )


def _node_status(node: NodeSession, now_ns: int) -> NodeStatus:
    counts, clock, health, newest = node.decoder.counts, node.clock.estimate(), node.health, node.newest_block
    return NodeStatus(
        node.name,
        node.link,
        node.node_id,
        node.rate(now_ns),
        (now_ns - node.last_frame_ns) / NS_PER_S,
        counts.frames,
        counts.frames_lost,
        counts.samples,
        counts.samples_lost,
        counts.restarts,
        clock.offset_ns / NS_PER_S,
        clock.drift,
        clock.sigma_ns / NS_PER_S if clock.source != "none" else None,
        newest.temperature if newest is not None else None,
        health.battery_mv / 1000 if health is not None and health.battery_mv else None,
        node.filter_report.bias if node.filter_report is not None else None,
        _mean_vector(newest.gyro) if newest is not None else None,
        _mean_vector(newest.accel) if newest is not None else None,
        node.decoder.mismatch_text,
        asleep=is_asleep(health),
    )


def _topic_link_status(topic: TopicSession) -> LinkStatus:
    connection = topic.connection
    return LinkStatus(
        topic.port.label,
        connection.endpoint,
        topic.messages,
        topic.bytes,
        0,
        topic.damage.total(),
        connection.disconnections,
        None,
        connection.faults,
    )


def _topic_node_status(topic: TopicSession, samples: ImuHandler, now_ns: int) -> NodeStatus:
    """Return the status of a node whose samples are messages of a topic."""
    clock, newest = topic.clock.sync.estimate(), samples.newest_block
    return NodeStatus(
        topic.port.label,
        topic.port.label,
        0,
        topic.rate(now_ns),
        (now_ns - topic.last_message_ns) / NS_PER_S,
        topic.messages,
        topic.samples_lost,
        topic.samples,
        topic.samples_lost,
        0,
        clock.offset_ns / NS_PER_S,
        clock.drift,
        clock.sigma_ns / NS_PER_S if clock.source != "none" else None,
        None,
        None,
        None,
        _mean_vector(newest.gyro) if newest is not None else None,
        _mean_vector(newest.accel) if newest is not None else None,
        None,
    )


def _topic_gnss_status(topic: TopicSession, receiver: FixHandler) -> GnssStatus:
    fix = receiver.last_fix
    return GnssStatus(
        topic.port.label,
        receiver.fixes,
        topic.damage.total(),
        None if fix is None else fix.latitude_deg,
        None if fix is None else fix.longitude_deg,
    )


def _mean_vector(rows: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = rows.mean(axis=0).tolist()
    return x, y, z


def _odometry_status(recorder: Recorder) -> OdometryStatus | None:
    odometer = recorder.odometry.odometer
    state = odometer.state if odometer is not None else None
    if odometer is None or state is None:
        return None
    (xx, xy), (_, yy) = np.asarray(state.covariance)[:2, :2].tolist()
    worst = (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
    return OdometryStatus(
        state.x,
        state.y,
        state.heading,
        state.speed,
        state.yaw_rate,
        math.sqrt(max(worst, 0.0)),
        odometer.distance,
        odometer.pose_count,
    )
