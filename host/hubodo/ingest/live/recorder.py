"""All links and nodes of a recording, without I/O: news in, log records and questions to nodes out.

Each link, node, receiver and the odometry is a part of its own behind a bulkhead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from hubodo.calibration.apply import check_serial
from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError, InputError, WireMismatch
from hubodo.fuse.wheel.records import Pose
from hubodo.ingest.gnss.session import GnssSession
from hubodo.ingest.link.link import Chunk, LinkLost, LinkReport, LinkUp, RefusedDatagrams
from hubodo.ingest.link.session import DAMAGED_SUFFIX, LinkSession
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.latency import Latency
from hubodo.ingest.live.live_map import LiveMap
from hubodo.ingest.live.localizer import FixSample
from hubodo.ingest.live.localizer_thread import Answer, LocalizerThread
from hubodo.ingest.live.odometer import Block, Odometer, OdometryRows
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.identity import describe_firmware_difference, hello_metadata
from hubodo.ingest.node.naming import assign_name
from hubodo.ingest.node.published import LogTimeSequence, Published
from hubodo.ingest.node.request_encoder import identification_request
from hubodo.ingest.node.senders import Route
from hubodo.ingest.node.session import NodeSession
from hubodo.ingest.sink import Sink
from hubodo.recording import Event
from hubodo.vehicle import Vehicle
from hubowire import Frame, Message, node_name

Send = Callable[[str, bytes, str], bool]


class Recorder:
    """Routes what links report to nodes, odometry and log.

    links: label -> name for the node behind it, or None to take it from the node id. gnss: labels of
    links that carry NMEA. send(link, bytes, to) writes to a link. Every node name occurs once. vehicle
    switches odometry on; calibration is applied to what goes into it; t_zero_ns: host time of t = 0;
    odometry_rate_hz: poses a second at most. localizer: gets odometry and fixes; what it answers is to come
    back through `handle`. bulkheads: keep account of faults; None: of this recorder alone.
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
        calibration: Calibration | None = None,
        t_zero_ns: int = 0,
        odometry_rate_hz: float | None = None,
        clock_period: float = 1.0,
        localizer: LocalizerThread | None = None,
        bulkheads: Bulkheads | None = None,
    ) -> None:
        self.bulkheads = bulkheads or Bulkheads(now_ns)
        self.links = {label: LinkSession(label, sink) for label in links}
        self._order = LogTimeSequence()
        self.gnss = {label: GnssSession(label, sink, self._order) for label in gnss}
        self.nodes: dict[tuple[str, int, int], NodeSession] = {}
        """By link, node id, and which board of that id: on a line there is one."""
        self.odometer: Odometer | None = None
        if vehicle is not None:
            self.odometer = Odometer(vehicle, t_zero_ns, calibration=calibration, rate_hz=odometry_rate_hz)
        self.latency = Latency()
        self.notices: list[Event] = []
        """What the user should hear of, for whoever shows the recording to take away."""
        self.map = LiveMap(localizer, sink, now_ns, self.notices)
        self._calibration = calibration or Calibration()
        self._fitting: dict[tuple[str, str], bool] = {}
        self._told: set[str] = set()
        self._misfit: CalibrationError | None = None
        self._names = dict(links)
        self._sink = sink
        self._send = send
        self._now_ns = now_ns
        self._clock_period = clock_period
        self._unread = 0
        self._firmware: dict[str, tuple[int, ...]] = {}

    def handle(self, news: LinkReport | Answer) -> None:
        """One thing that a link reported, or the localizer answered."""
        if isinstance(news, Answer):
            self.bulkheads.run("map", self.map.handle, news)
        elif news.link in self.gnss:
            cause = news.data if isinstance(news, Chunk) else b""
            gnss = self.gnss[news.link]
            self.bulkheads.run(f"receiver {news.link}", self._from_receiver, gnss, news, cause=cause)
        elif not isinstance(news, Chunk):
            self.bulkheads.run(f"link {news.link}", self._link_changed, self.links[news.link], news)
        else:
            self._take_bytes(self._split, news)

    def _take_bytes(self, action: Callable[[Chunk], None], news: Chunk) -> None:
        """Pass bytes of a link to `action`; where it fails they are logged as they came."""
        if not self.bulkheads.run(f"link {news.link}", action, news, cause=news.data):
            self._sink.write_raw_frame(news.link + DAMAGED_SUFFIX, news.t_ns, news.data)

    def _split(self, news: Chunk) -> None:
        link = self.links[news.link]
        for route in link.route_frames(news):
            self._frame(link, route, news)

    def _link_changed(self, link: LinkSession, news: LinkUp | LinkLost | RefusedDatagrams) -> None:
        match news:
            case LinkUp():
                link.handle_up(news)
                for node in self._on(news.link):
                    node.mute()
            case LinkLost():
                link.handle_lost(news)
            case RefusedDatagrams():
                self.notices.append(link.report_refused(news))
        self.notices += link.connection.take_notices()

    def _from_receiver(self, gnss: GnssSession, news: LinkReport) -> None:
        """One thing that the link of a GNSS receiver reported."""
        match news:
            case LinkUp():
                gnss.connection.handle_up(news)
            case LinkLost():
                gnss.connection.handle_lost(news)
            case Chunk():
                self._locate(gnss.handle_bytes(news.data, news.t_ns), news.t_ns)
        self.notices += gnss.connection.take_notices()

    def tick(self, now_ns: int) -> None:
        """Call every 0.1 s or so."""
        for link in self.links.values():
            self.bulkheads.run(f"link {link.label}", self._tick_link, link, now_ns)
        for node in list(self.nodes.values()):
            self.bulkheads.run(_part(node), self._tick_node, node, now_ns)
        self.bulkheads.run("status", self._compare_firmware)
        self.bulkheads.run("odometry", self._warn, now_ns)
        for event in self.bulkheads.reports():
            self.report(event)

    def _tick_link(self, link: LinkSession, now_ns: int) -> None:
        self.notices += link.tick(now_ns)

    def _tick_node(self, node: NodeSession, now_ns: int) -> None:
        self._fuse(node.tick(now_ns), now_ns)
        self.notices += node.notices
        node.notices.clear()

    def request(self, node: str, message: Message, words: str) -> bool:
        """Asks a node for a user; see `NodeSession.request`. Whether there is such a node."""
        found = next((session for session in self.nodes.values() if session.name == node), None)
        if found is not None:
            found.request(message, words)
        return found is not None

    def mark(self, text: str) -> None:
        """An event of the user's own."""
        self._sink.write_event(Event(self._now_ns(), "mark", "user", text))

    def host_clock(self, event: Event, record: Mapping[str, str]) -> None:
        """Note what has happened to the computer's clocks; record: the metadata `clock` from then on."""
        self.report(event)
        if record:
            self._sink.add_metadata("clock", record)
        begin_ns = event.data.get("begin_ns")
        if begin_ns is None:
            return
        for link in self.links.values():
            link.restart_timeouts(event.t_ns)
        for node in self.nodes.values():
            node.note_host_suspension(begin_ns, event.t_ns)

    def keep(self, news: LinkReport | Answer) -> None:
        """One thing for which there is no time left: bytes of nodes go into the log as they are."""
        if isinstance(news, Chunk) and news.link in self.links:
            self._take_bytes(self._keep, news)
        elif not isinstance(news, Answer):
            self.handle(news)

    def _keep(self, news: Chunk) -> None:
        self._unread += self.links[news.link].log_undecoded(news)

    def tell_again(self) -> None:
        """Another log has begun: it is told what the one before knew and no message will say again."""
        now_ns = self._now_ns()
        for node in self.nodes.values():
            self.bulkheads.run(_part(node), node.repeat_state, now_ns)
        self.map.repeat_origin(now_ns)

    def report(self, event: Event) -> None:
        """An event for the user and the log."""
        self.notices.append(event)
        self._sink.write_event(event)

    def warn(self, source: str, text: str) -> None:
        """One line for the user and the log."""
        self.report(Event(self._now_ns(), "warning", source, text))

    def close(self) -> None:
        """The end of the recording: writes what waited."""
        now_ns, run = self._now_ns(), self.bulkheads.run
        for node in self.nodes.values():
            run(_part(node), self._close_node, node, now_ns)
        for gnss in self.gnss.values():
            run(f"receiver {gnss.label}", lambda gnss=gnss: self._locate(gnss.close(), now_ns))
        run("odometry", self._close_odometry, now_ns)
        if self._unread:
            self.warn(
                "recorder",
                f"{self._unread} frames are in the log raw, not decoded: hubodo import decodes them",
            )
        for link in self.links.values():
            run(f"link {link.label}", link.close, now_ns)
        for event in self.bulkheads.reports(final=True):
            self.report(event)

    def _close_node(self, node: NodeSession, now_ns: int) -> None:
        self._fuse(node.close(now_ns), now_ns)

    def _close_odometry(self, now_ns: int) -> None:
        if self.odometer is not None:
            self._publish(self.odometer.finish(), now_ns)
        self._warn(now_ns, end=True)

    def verdict(self) -> WireMismatch | InputError | CalibrationError | None:
        """Why it makes no sense to go on, None while it does.

        WireMismatch: the nodes of every link speak another version. InputError: no link has ever carried
        a frame, and all of them speak something else. CalibrationError: the calibration is of other nodes.
        """
        if self._misfit is not None:
            return self._misfit
        nodes = list(self.nodes.values())
        refusals = [node.decoder.mismatch_text for node in nodes if node.decoder.mismatch_text is not None]
        if refusals and len(refusals) == len(nodes) and {node.link for node in nodes} == set(self.links):
            return WireMismatch("; ".join(refusals))
        strangers = [link for link in self.links.values() if link.foreign is not None and not link.frames]
        if strangers and len(strangers) == len(self.links):
            return InputError("; ".join(f"{link.label} ({link.where}): {link.foreign}" for link in strangers))
        return None

    def _tell(self, t_ns: int, kind: str, source: str, text: str) -> None:
        self.notices.append(Event(t_ns, kind, source, text))

    def _on(self, label: str) -> list[NodeSession]:
        return [node for (link, _, _), node in self.nodes.items() if link == label]

    def _frame(self, link: LinkSession, route: Route, news: Chunk) -> None:
        """Hand a frame to its node, behind those that waited for it."""
        if route.should_identify:
            self._transmit(link.label, identification_request(route.node_id), news.sender)
        if route.board is None:
            return
        node = self._node(link, (link.label, route.node_id, route.board))
        part = _part(node)
        for frame, t_ns, counts in route.frames:
            cause = bytes((frame.type_id, frame.node)) + frame.payload
            self.bulkheads.run(part, self._read, node, frame, t_ns, counts, news.t_ns, cause=cause)
        self._pass_on(link, node, news.t_ns)

    def _read(self, node: NodeSession, frame: Frame, t_ns: int, link: LinkCounts, arrived_ns: int) -> None:
        self._fuse(node.handle_frame(frame, t_ns, link), arrived_ns)

    def _transmit(self, label: str, data: bytes, to: str) -> bool:
        sent: list[bool] = []
        self.bulkheads.run(
            f"sending on {label}", lambda: sent.append(self._send(label, data, to)), pausing=True
        )
        return any(sent)

    def _pass_on(self, link: LinkSession, receiver: NodeSession, t_ns: int) -> None:
        """What a receiver says of the nodes behind it, to these."""
        heard, receiver.received_signals = receiver.received_signals, []
        for signal in heard:
            for node in self._on(link.label):
                if node.node_id == signal.of_node:
                    self._fuse(node.update_signal(signal), t_ns)

    def _node(self, link: LinkSession, key: tuple[str, int, int]) -> NodeSession:
        node = self.nodes.get(key)
        if node is None:

            def send(question: bytes) -> bool:
                return self._transmit(link.label, question, link.senders.address(*key[1:]))

            node = self.nodes[key] = NodeSession(
                self._name(link.label, key[1]),
                link.label,
                key[1],
                send,
                self._sink,
                self._now_ns,
                datagrams=link.datagrams,
                clock_period=self._clock_period,
                order=self._order,
            )
        return node

    def _name(self, label: str, node_id: int) -> str:
        taken = {node.name for node in self.nodes.values()}
        unique, clash = assign_name(self._names[label], node_id, taken)
        if not clash:
            return unique
        name = node_name(node_id)
        text = (
            f"{label}: another node called {name!r} is there already; this one is recorded as {unique!r}: "
            f"give ports names (left=/dev/...) or change the node id"
        )
        self._tell(self._now_ns(), "warning", label, text)
        return unique

    def _fuse(self, published: Iterable[Published], arrived_ns: int) -> None:
        for item in published:
            if self.odometer is not None:
                self.bulkheads.run("odometry", self._estimate, self.odometer, item, arrived_ns)

    def _estimate(self, odometer: Odometer, item: Published, arrived_ns: int) -> None:
        if not self._fits(item, arrived_ns):
            return
        block = item.block
        rows = Block(
            item.node,
            item.t_ns,
            block.gyro,
            block.accel,
            block.temperature,
            item.power_on_ns,
            item.supply,
        )
        self._publish(odometer.handle(rows), arrived_ns)

    def _publish(self, motions: Iterable[OdometryRows], arrived_ns: int) -> None:
        for motion in motions:
            motion.write(self._sink, self._now_ns())
            self.latency.add(self._now_ns() - arrived_ns)
        if self.odometer is not None:
            self._locate(self.odometer.fresh(), arrived_ns)

    def _locate(self, items: Iterable[Pose | FixSample], arrived_ns: int) -> None:
        if self.odometer is not None:
            self.map.put(items, arrived_ns)

    def _compare_firmware(self) -> None:
        """Warn where nodes run different firmware, once for each change."""
        hellos = ((node.name, node.decoder.hello) for node in self.nodes.values())
        versions: dict[str, tuple[int, ...]] = {
            name: hello.firmware for name, hello in hellos if hello is not None
        }
        if versions != self._firmware:
            self._firmware = versions
            difference = describe_firmware_difference(versions)
            if difference is not None:
                self.warn("recorder", difference)

    def _warn(self, now_ns: int, *, end: bool = False) -> None:
        """What the odometer has to say, to the user and into the log."""
        if self.odometer is None:
            return
        for line in self.odometer.warnings(end=end):
            self._tell(now_ns, "warning", "odometry", f"odometry: {line}")
            self._sink.write_event(Event(now_ns, "warning", "odometry", line))

    def _fits(self, item: Published, now_ns: int) -> bool:
        """Whether the calibration is that of the node; one that is of another keeps it from the odometry."""
        calibrated = self._calibration.nodes.get(item.node)
        node = next((node for node in self.nodes.values() if node.name == item.node), None)
        hello = None if node is None else node.decoder.hello
        if hello is not None and item.node not in self._told and self.odometer is not None:
            self._told.add(item.node)
            self.odometer.told(item.node, hello_metadata(hello))
        if calibrated is None or node is None or node.decoder.hello is None:
            return True
        serial = node.decoder.hello.serial.hex()
        known = self._fitting.get((item.node, serial))
        if known is None:
            try:
                check_serial(item.node, calibrated, serial)
                known = True
            except CalibrationError as error:
                known = False
                if self.odometer is not None and not self.odometer.poses:
                    self._misfit = error
                data = {"node": item.node, "serial": serial, "calibrated": calibrated.serial}
                text = f"{error}; its samples are recorded, the odometry goes without them"
                self._tell(now_ns, "mismatch", item.node, text)
                self._sink.write_event(Event(now_ns, "mismatch", item.node, str(error), data))
            self._fitting[item.node, serial] = known
        return known


def _part(node: NodeSession) -> str:
    """Return the name of a node's part behind its bulkhead."""
    return f"node {node.name}"
