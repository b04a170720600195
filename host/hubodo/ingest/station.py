"""All links and nodes of a recording, without I/O: news in, log records and questions to nodes out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from hubodo.config import Vehicle
from hubodo.errors import InputError, WireMismatch
from hubodo.fuse.odometry import DifferentialOdometry, OdometryConfig, WheelSamples, WheelSpec
from hubodo.ingest.gnss_session import GnssSession
from hubodo.ingest.link import Chunk, LinkLost, LinkNews, LinkUp
from hubodo.ingest.link_session import LinkSession
from hubodo.ingest.node_session import NodeSession, Published
from hubodo.ingest.sink import Sink
from hubodo.model.frames import Side
from hubowire import Frame, node_name

S = 1_000_000_000
_SIDES: tuple[Side, ...] = ("left", "right")

Send = Callable[[str, bytes, str], bool]


class Latency:
    """Time from the arrival of the bytes that completed a pose to the pose in the log."""

    def __init__(self) -> None:
        self.count = 0
        self.total_ns = 0
        self.worst_ns = 0

    def add(self, ns: int) -> None:
        self.count += 1
        self.total_ns += ns
        self.worst_ns = max(self.worst_ns, ns)

    @property
    def mean(self) -> float | None:
        """s; None before the first pose."""
        return self.total_ns / self.count / S if self.count else None


class Station:
    """Routes what links report to nodes, odometry and log.

    links: label -> name for the node behind it, or None to take it from the node id. gnss: labels of
    links that carry NMEA. send(link, bytes, to) writes to a link. Every node name occurs once.
    """

    def __init__(
        self,
        links: Mapping[str, str | None],
        sink: Sink,
        send: Send,
        now_ns: Callable[[], int],
        *,
        gnss: Iterable[str] = (),
        vehicle: Vehicle | None = None,
        odometry_rate_hz: float = 100.0,
        clock_period: float = 1.0,
    ) -> None:
        self.links = {label: LinkSession(label, sink) for label in links}
        self.gnss = {label: GnssSession(label, sink) for label in gnss}
        self.nodes: dict[tuple[str, int], NodeSession] = {}
        self.odometry = None if vehicle is None else _odometry(vehicle, odometry_rate_hz)
        self.latency = Latency()
        self.poses = 0
        self.notices: list[str] = []
        self._wheels: dict[str, Side] = {}
        if vehicle is not None:
            self._wheels = {name: side for side in _SIDES if (name := vehicle.on(side)) is not None}
        self._names = dict(links)
        self._sink = sink
        self._send = send
        self._now_ns = now_ns
        self._clock_period = clock_period
        self._senders: dict[tuple[str, int], str] = {}

    def handle(self, news: LinkNews) -> None:
        """One thing that a link reported."""
        if news.link in self.gnss:
            if isinstance(news, Chunk):
                self.gnss[news.link].chunk(news.data, news.t_ns)
            return
        link = self.links[news.link]
        match news:
            case LinkUp():
                if link.missed:
                    self.notices.append(f"{news.link}: connected at {news.where}")
                link.up(news)
                for node in self._on(news.link):
                    node.mute()
            case LinkLost():
                self.notices.append(f"{news.link}: {news.text} (waiting for it)")
                link.lost(news)
            case Chunk():
                for frame in link.chunk(news):
                    self._senders[news.link, frame.node] = news.sender
                    node = self._node(link, frame)
                    self._fuse(node.frame(frame, news.t_ns, link.counts), news.t_ns)

    def tick(self, now_ns: int) -> None:
        """Call every 0.1 s or so."""
        for link in self.links.values():
            self.notices += link.tick(now_ns)
        for node in list(self.nodes.values()):
            self._fuse(node.tick(now_ns), now_ns)

    def close(self) -> None:
        """The end of the recording: writes what waited."""
        now_ns = self._now_ns()
        for node in self.nodes.values():
            self._fuse(node.close(now_ns), now_ns)
        for link in self.links.values():
            link.close(now_ns)
        for gnss in self.gnss.values():
            gnss.close()

    def verdict(self) -> WireMismatch | InputError | None:
        """Why nobody is left to listen to, None while somebody is.

        WireMismatch: the nodes of every link speak another version. InputError: no link has ever carried
        a frame, and all of them speak something else.
        """
        nodes = list(self.nodes.values())
        refusals = [node.decoder.refusal for node in nodes if node.decoder.refusal is not None]
        if refusals and len(refusals) == len(nodes) and {node.link for node in nodes} == set(self.links):
            return WireMismatch("; ".join(refusals))
        strangers = [link for link in self.links.values() if link.foreign is not None and not link.frames]
        if strangers and len(strangers) == len(self.links):
            return InputError("; ".join(f"{link.label} ({link.where}): {link.foreign}" for link in strangers))
        return None

    def _on(self, label: str) -> list[NodeSession]:
        return [node for (link, _), node in self.nodes.items() if link == label]

    def _node(self, link: LinkSession, frame: Frame) -> NodeSession:
        key = (link.label, frame.node)
        node = self.nodes.get(key)
        if node is None:

            def send(question: bytes) -> bool:
                return self._send(link.label, question, self._senders.get(key, ""))

            node = self.nodes[key] = NodeSession(
                self._name(link.label, frame.node),
                link.label,
                frame.node,
                send,
                self._sink,
                self._now_ns,
                datagrams=link.datagrams,
                clock_period=self._clock_period,
            )
        return node

    def _name(self, label: str, node_id: int) -> str:
        wanted = self._names[label]
        taken = {node.name for node in self.nodes.values()}
        if wanted is not None and wanted not in taken:
            return wanted
        name = node_name(node_id)
        if name not in taken:
            return name
        unique = next(f"{name}_{n}" for n in range(2, 300) if f"{name}_{n}" not in taken)
        self.notices.append(
            f"{label}: another node called {name!r} is there already; this one is recorded as {unique!r}: "
            f"give ports names (left=/dev/...) or change the node id"
        )
        return unique

    def _fuse(self, published: Iterable[Published], arrived_ns: int) -> None:
        for item in published:
            side = self._wheels.get(item.node)
            if self.odometry is None or side is None:
                continue
            states = self.odometry.handle(
                WheelSamples(side, item.t_ns, item.block.gyro, item.block.accel)
            ).states
            if not states:
                continue
            now_ns = self._now_ns()
            t_ns = np.array([state.t_ns for state in states], np.int64)
            position = np.array([(state.x, state.y) for state in states])
            heading = np.array([state.heading for state in states])
            self._sink.odometry(
                t_ns,
                now_ns,
                position,
                heading,
                [state.speed for state in states],
                [state.yaw_rate for state in states],
                pose_covariance=[state.covariance for state in states],
                twist_covariance=[state.twist_covariance for state in states],
            )
            self._sink.transform(t_ns, now_ns, position, heading)
            self.poses += len(states)
            self.latency.add(self._now_ns() - arrived_ns)


def _odometry(vehicle: Vehicle, rate_hz: float) -> DifferentialOdometry:
    sides: dict[Side, WheelSpec] = {}
    for side in _SIDES:
        name = vehicle.on(side)
        facing = vehicle.nodes[name].facing if name is not None else None
        if facing is None:
            raise InputError(
                f"odometry needs a node on each wheel: [nodes] has none with side = {side!r}; add it"
            )
        sides[side] = WheelSpec(vehicle.wheel_radius, facing)
    return DifferentialOdometry(
        OdometryConfig(sides["left"], sides["right"], vehicle.track_width, round(S / rate_hz))
    )
