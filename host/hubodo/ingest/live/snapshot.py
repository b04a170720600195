"""How a recording fares at one moment: small, unchangeable, and free to be read from any thread."""

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
from hubodo.ingest.live.tee_sink import Listener
from hubodo.ingest.node.session import NodeSession
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.recording import Event
from hubodo.units import NS_PER_S


@dataclass(frozen=True, slots=True)
class LinkNow:
    """A link. where: the device of today, None while it is down; counts are since the start.

    faults: unexpected exceptions of the port's driver. refused: datagrams that no key proved, and frames of
    nodes beyond the limit. senders_evicted: that never identified themselves.
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
class NodeNow:
    """A node. rate: Hz over two seconds; clock_*: s, drift as a share, sigma None before anything is known.

    age: s since its last frame. gyro, accel: (3,) means of its newest block, rad/s and m/s², node axes;
    bias: (3,) rad/s by its own filter, None before it has one. temperature: °C. battery: V.
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


@dataclass(frozen=True, slots=True)
class GnssNow:
    """A receiver. latitude_deg, longitude_deg: of its last fix, None before one."""

    label: str
    fixes: int
    checksum_errors: int
    latitude_deg: float | None
    longitude_deg: float | None


@dataclass(frozen=True, slots=True)
class OdometryNow:
    """Where the vehicle is: m, rad, m/s, rad/s; sigma: m along the worse direction; distance: m so far."""

    x: float
    y: float
    heading: float
    speed: float
    yaw_rate: float
    sigma: float
    distance: float
    poses: int


@dataclass(frozen=True, slots=True)
class LogNow:
    """The log. path: of the one that is open, else the last; size: its bytes; total: of all since the start.

    recording: whether what comes goes into it; trouble: why not, or what was wrong with a log that ended
    early; logs: begun so far; messages_lost: that no log has; disk_free, disk_size: bytes, None where the
    folder is not there.
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
    """A recording. t_ns: host time of it; started_ns: of the start; memory: bytes in use by the process.

    map: where the odometry puts the vehicle on the map, (x east, y north) m, with a graph and once known.
    faults: exceptions and hangs of each part that has had any, since the start.
    """

    t_ns: int
    started_ns: int
    log: LogNow
    links: tuple[LinkNow, ...]
    nodes: tuple[NodeNow, ...]
    gnss: tuple[GnssNow, ...]
    odometry: OdometryNow | None
    map: tuple[float, float] | None
    memory: int | None
    faults: Mapping[str, int]

    @property
    def seconds(self) -> float:
        """Since the start, s."""
        return (self.t_ns - self.started_ns) / NS_PER_S


Watch = Callable[[Snapshot], Iterable[Event] | None]
"""Called with each snapshot in the recorder's own thread; must return at once. Events go into the log."""


class Audience(Protocol):
    """Who watches closely. Called in the recorder's own thread, so it must not wait for anybody."""

    def attach(self, log: LogWriter, series: LogSeries, bulkheads: Bulkheads) -> Mapping[str, Listener]:
        """Called once, before the start; return what listens to all that is written, by its part's name."""
        ...

    def poll(self, recorder: Recorder, now_ns: int) -> None:
        """Called some fifty times a second."""
        ...

    def show(self, snapshot: Snapshot) -> None:
        """Called once a second."""
        ...


class Watched:
    """Shows a recorder once a second to those who want to know, each as a part of its own."""

    def __init__(
        self,
        recorder: Recorder,
        log: Callable[[], LogNow],
        watch: Mapping[str, Watch],
        audience: Audience | None = None,
    ) -> None:
        """watch: by the name of the part."""
        self._recorder, self._log, self._audience = recorder, log, audience
        self._watch = dict(watch)
        if audience is not None:
            self._watch["page"] = audience.show
        self._started_ns = self._next_ns = 0

    def add(self, part: str, watch: Watch) -> None:
        """Another one who wants to know."""
        self._watch[part] = watch

    def tick(self, now_ns: int) -> None:
        """Call often; the first call is the start."""
        run = self._recorder.bulkheads.run
        if self._audience is not None:
            run("page", self._audience.poll, self._recorder, now_ns, pausing=True)
        if now_ns < self._next_ns or not self._watch:
            return
        self._started_ns = self._started_ns or now_ns
        self._next_ns = now_ns + NS_PER_S
        run("status", self._show, now_ns)

    def _show(self, now_ns: int) -> None:
        snapshot = take_snapshot(self._recorder, self._log(), self._started_ns, now_ns)
        for part, watch in self._watch.items():
            self._recorder.bulkheads.run(part, self._pass_on, watch, snapshot, pausing=True)

    def _pass_on(self, watch: Watch, snapshot: Snapshot) -> None:
        for event in watch(snapshot) or ():
            self._recorder.report(event)


def take_snapshot(recorder: Recorder, log: LogNow, started_ns: int, now_ns: int) -> Snapshot:
    """How it is now; to be called by the thread that feeds the recorder."""
    located = recorder.map.located
    return Snapshot(
        now_ns,
        started_ns,
        log,
        tuple(_link(link) for link in recorder.links.values()),
        tuple(_node(node, now_ns) for node in recorder.nodes.values()),
        tuple(
            GnssNow(
                label,
                session.decoder.counts.fixes,
                session.decoder.counts.checksum_errors,
                session.last_fix.latitude_deg if session.last_fix is not None else None,
                session.last_fix.longitude_deg if session.last_fix is not None else None,
            )
            for label, session in recorder.gnss.items()
        ),
        _odometry(recorder),
        None if located is None else (float(located.position[0, 0]), float(located.position[0, 1])),
        memory_in_use(),
        recorder.bulkheads.counts(),
    )


def memory_in_use() -> int | None:
    """Bytes that the process holds in memory; None where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_bytes().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError, AttributeError):
        return None


def _link(link: LinkSession) -> LinkNow:
    return LinkNow(
        link.label,
        link.where,
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


def _node(node: NodeSession, now_ns: int) -> NodeNow:
    counts, clock, health, newest = node.decoder.counts, node.clock.estimate(), node.health, node.newest_block
    return NodeNow(
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
        _mean(newest.gyro) if newest is not None else None,
        _mean(newest.accel) if newest is not None else None,
        node.decoder.mismatch_text,
    )


def _mean(rows: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = rows.mean(axis=0).tolist()
    return x, y, z


def _odometry(recorder: Recorder) -> OdometryNow | None:
    odometer = recorder.odometer
    state = odometer.state if odometer is not None else None
    if odometer is None or state is None:
        return None
    (xx, xy), (_, yy) = np.asarray(state.covariance)[:2, :2].tolist()
    worst = (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
    return OdometryNow(
        state.x,
        state.y,
        state.heading,
        state.speed,
        state.yaw_rate,
        math.sqrt(max(worst, 0.0)),
        odometer.distance,
        odometer.poses,
    )
