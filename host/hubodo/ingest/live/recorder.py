"""All links and nodes of a recording, without I/O: reports in, log records and requests to nodes out.

Each link, node and receiver, and the odometry, is a part of its own behind a bulkhead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError, InputError, WireMismatch
from hubodo.ingest.gnss.session import GnssSession
from hubodo.ingest.link.connection import Connection
from hubodo.ingest.link.link import Chunk, LinkLost, LinkReport, LinkUp, RefusedDatagrams, TopicMessage
from hubodo.ingest.link.session import DAMAGED_SUFFIX, LinkSession
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.live_map import LiveMap
from hubodo.ingest.live.localizer_thread import LocalizerOutput, LocalizerThread
from hubodo.ingest.live.odometer import Odometer, SpeedSample
from hubodo.ingest.live.odometry_requests import OdometryRequest
from hubodo.ingest.live.recorded_odometry import RecordedOdometry
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.node.registry import NodeRegistry
from hubodo.ingest.node.request_encoder import identification_request
from hubodo.ingest.node.senders import Route
from hubodo.ingest.node.session import NodeSession
from hubodo.ingest.topic.handlers import TopicItem, create_handler
from hubodo.ingest.topic.port import TopicPort
from hubodo.ingest.topic.session import TopicSession
from hubodo.log.records import EventRecord, ImuBlock, Metadata, RawFrame, Sink
from hubodo.recording import Event
from hubodo.vehicle import Vehicle
from hubowire import Frame, Message

RecorderInput = LinkReport | LocalizerOutput | OdometryRequest
SendToLink = Callable[[str, bytes, str], bool]


class Recorder:
    """Routes the reports of links to nodes, odometry and log.

    links: node name by link label, None to derive it from the node id. gnss: labels of links with NMEA.
    topic_ports: ROS 2 topics that are recorded.
    send(link, bytes, to): writes to a link. vehicle: enables odometry; calibration: applied to its samples.
    clock_period: interval of clock requests, s. localizer: receives odometry and fixes; its outputs are to be
    passed to `handle`. bulkheads: count the faults of parts.
    """

    def __init__(
        self,
        links: Mapping[str, str | None],
        sink: Sink,
        send: SendToLink,
        now_ns: Callable[[], int],
        *,
        gnss: Iterable[str] = (),
        topic_ports: Iterable[TopicPort] = (),
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
        self._log_times = LogTimeSequence()
        self.gnss = {label: GnssSession(label, sink, self._log_times) for label in gnss}
        topic_ports = tuple(topic_ports)
        self.topics = {
            port.label: TopicSession(port, create_handler(port, sink, self._log_times, vehicle), sink)
            for port in topic_ports
        }
        self.notices: list[Event] = []
        """Events for the user; the view removes them once shown."""
        self.nodes = NodeRegistry(
            links,
            sink,
            self._transmit,
            now_ns,
            reserved=set(self.topics),
            order=self._log_times,
            clock_period=clock_period,
            warn=lambda source, text: self.notices.append(Event(now_ns(), "warning", source, text)),
        )
        self.map = LiveMap(localizer, sink, now_ns, self.notices)
        odometer = None
        if vehicle is not None:
            odometer = Odometer(
                vehicle,
                t_zero_ns,
                calibration=calibration,
                rate_hz=odometry_rate_hz,
                encoder_aided=any(port.role == "wheels" for port in topic_ports),
            )
        self.odometry = RecordedOdometry(
            odometer,
            self.map,
            calibration or Calibration(),
            order=self._log_times,
            sink=sink,
            now_ns=now_ns,
            notices=self.notices,
            bulkheads=self.bulkheads,
        )
        self._sink, self._send, self._now_ns = sink, send, now_ns
        self._undecoded_pieces = 0

    def handle(self, report: RecorderInput) -> None:
        """Handle a report of a link, an output of the localizer, or a request of another program."""
        if isinstance(report, LocalizerOutput):
            self.bulkheads.run("map", self.map.handle, report)
        elif isinstance(report, OdometryRequest):
            self.odometry.handle_request(report, self.nodes)
        elif report.link in self.gnss:
            cause = report.data if isinstance(report, Chunk) else b""
            gnss = self.gnss[report.link]
            self.bulkheads.run(f"receiver {report.link}", self._handle_gnss, gnss, report, cause=cause)
        elif report.link in self.topics:
            message = report.payload if isinstance(report, TopicMessage) else b""
            topic = self.topics[report.link]
            self.bulkheads.run(f"topic {report.link}", self._handle_topic, topic, report, cause=message)
        elif not isinstance(report, Chunk | TopicMessage):
            self.bulkheads.run(
                f"link {report.link}", self._handle_link_change, self.links[report.link], report
            )
        elif isinstance(report, Chunk):
            self._handle_chunk(self._decode_chunk, report)

    def _handle_chunk(self, action: Callable[[Chunk], None], chunk: Chunk) -> None:
        """Pass received bytes to `action`; if it fails, log them raw."""
        if not self.bulkheads.run(f"link {chunk.link}", action, chunk, cause=chunk.data):
            self._sink.write_record(RawFrame(chunk.link + DAMAGED_SUFFIX, chunk.t_ns, chunk.data))

    def _decode_chunk(self, chunk: Chunk) -> None:
        link = self.links[chunk.link]
        for route in link.route_frames(chunk):
            self._handle_route(link, route, chunk)

    def _handle_link_change(self, link: LinkSession, report: LinkUp | LinkLost | RefusedDatagrams) -> None:
        match report:
            case LinkUp():
                link.handle_up(report)
                for node in self.nodes.on_link(report.link):
                    node.mute()
            case LinkLost():
                link.handle_lost(report)
            case RefusedDatagrams():
                self.notices.append(link.report_refused(report))
        self.notices += link.connection.take_notices()

    def _handle_gnss(self, gnss: GnssSession, report: LinkReport) -> None:
        """Handle a report of the link of a GNSS receiver."""
        self._handle_connection(gnss.connection, report)
        if isinstance(report, Chunk):
            self.odometry.add_fixes(gnss.handle_bytes(report.data, report.t_ns), report.t_ns)

    def _handle_topic(self, topic: TopicSession, report: LinkReport) -> None:
        """Handle a report of the link of a ROS 2 topic."""
        self._handle_connection(topic.connection, report)
        if isinstance(report, TopicMessage):
            for item in topic.handle_message(report):
                self._handle_topic_item(item, report.t_ns)

    def _handle_topic_item(self, item: TopicItem, arrived_ns: int) -> None:
        if isinstance(item, ImuBlock):
            self.odometry.add_samples([item], None, arrived_ns)
        elif isinstance(item, SpeedSample):
            self.odometry.add_speeds(item, arrived_ns)
        else:
            self.odometry.add_fixes([item], arrived_ns)

    def _handle_connection(self, connection: Connection, report: LinkReport) -> None:
        match report:
            case LinkUp():
                connection.handle_up(report)
            case LinkLost():
                connection.handle_lost(report)
        self.notices += connection.take_notices()

    def tick(self, now_ns: int) -> None:
        """Run the periodic tasks; to be called about every 0.1 s or more often."""
        for link in self.links.values():
            self.bulkheads.run(f"link {link.label}", self._tick_link, link, now_ns)
        for node in self.nodes:
            self.bulkheads.run(_part_name(node), self._tick_node, node, now_ns)
        for label, topic in self.topics.items():
            self.bulkheads.run(f"topic {label}", lambda topic=topic: self.notices.extend(topic.tick(now_ns)))
        self.bulkheads.run("status", self._compare_firmware)
        self.odometry.tick(now_ns)
        for event in self.bulkheads.due_reports():
            self.report_event(event)

    def _tick_link(self, link: LinkSession, now_ns: int) -> None:
        self.notices += link.tick(now_ns)

    def _tick_node(self, node: NodeSession, now_ns: int) -> None:
        self.odometry.add_samples(node.tick(now_ns), node, now_ns)
        self.notices += node.notices
        node.notices.clear()

    def request(self, node: str, message: Message, description: str) -> bool:
        """Send a request of a user to a node; return False if there is no such node."""
        session = self.nodes.named(node)
        if session is not None:
            session.request(message, description)
        return session is not None

    def add_mark(self, text: str) -> None:
        """Log an event with the text of the user."""
        self._sink.write_record(EventRecord(Event(self._now_ns(), "mark", "user", text)))

    def handle_clock_event(self, event: Event, metadata: Mapping[str, str]) -> None:
        """Handle an event of the host clock; metadata: new contents of the metadata record `clock`."""
        self.report_event(event)
        if metadata:
            self._sink.write_record(Metadata("clock", metadata))
        begin_ns = event.data.get("begin_ns")
        if begin_ns is None:
            return
        for link in self.links.values():
            link.restart_timeouts(event.t_ns)
        for node in self.nodes:
            node.note_host_suspension(begin_ns, event.t_ns)

    def log_undecoded(self, report: RecorderInput) -> None:
        """Handle a report for whose decoding there is no time: log bytes of nodes raw."""
        if isinstance(report, Chunk) and report.link in self.links:
            self._handle_chunk(self._log_chunk, report)
        elif not isinstance(report, LocalizerOutput):
            self.handle(report)

    def _log_chunk(self, chunk: Chunk) -> None:
        self._undecoded_pieces += self.links[chunk.link].log_undecoded(chunk)

    def repeat_state(self) -> None:
        """Repeat in a new log the state that later messages do not contain."""
        now_ns = self._now_ns()
        for node in self.nodes:
            self.bulkheads.run(_part_name(node), node.repeat_state, now_ns)
        self.map.repeat_origin(now_ns)

    def report_event(self, event: Event) -> None:
        """Show an event to the user and log it."""
        self.notices.append(event)
        self._sink.write_record(EventRecord(event))

    def warn(self, source: str, text: str) -> None:
        """Show a warning to the user and log it."""
        self.report_event(Event(self._now_ns(), "warning", source, text))

    def close(self) -> None:
        """End the recording: process and log everything that is held."""
        now_ns, run = self._now_ns(), self.bulkheads.run
        for node in self.nodes:
            run(_part_name(node), self._close_node, node, now_ns)
        for gnss in self.gnss.values():
            run(f"receiver {gnss.label}", lambda gnss=gnss: self.odometry.add_fixes(gnss.close(), now_ns))
        for label, topic in self.topics.items():
            run(f"topic {label}", topic.close, now_ns)
        self.odometry.close(now_ns)
        if self._undecoded_pieces:
            text = f"{self._undecoded_pieces} frames were logged raw, not decoded: hubodo import decodes them"
            self.warn("recorder", text)
        for link in self.links.values():
            run(f"link {link.label}", link.close, now_ns)
        for event in self.bulkheads.due_reports(final=True):
            self.report_event(event)

    def _close_node(self, node: NodeSession, now_ns: int) -> None:
        self.odometry.add_samples(node.close(now_ns), node, now_ns)

    def fatal_error(self) -> WireMismatch | InputError | CalibrationError | None:
        """Return the error that makes the recording useless; None if there is none.

        WireMismatch: the nodes of every link use another protocol version. InputError: no link has carried a
        frame, and all carry foreign data. CalibrationError: the calibration belongs to other nodes.
        """
        if self.odometry.calibration_error is not None:
            return self.odometry.calibration_error
        mismatch = self.nodes.mismatch()
        if mismatch is not None:
            return WireMismatch(mismatch)
        foreign_links = [link for link in self.links.values() if link.foreign is not None and not link.frames]
        if foreign_links and len(foreign_links) == len(self.links):
            return InputError(
                "; ".join(f"{link.label} ({link.endpoint}): {link.foreign}" for link in foreign_links)
            )
        return None

    def _handle_route(self, link: LinkSession, route: Route, chunk: Chunk) -> None:
        """Pass a frame to its node, after the held frames that precede it."""
        if route.should_identify:
            self._transmit(link.label, identification_request(route.node_id), chunk.sender)
        if route.board is None:
            return
        node = self.nodes.get_or_create(link, route.node_id, route.board)
        part = _part_name(node)
        for frame, t_ns, counts in route.frames:
            cause = bytes((frame.type_id, frame.node)) + frame.payload
            self.bulkheads.run(part, self._handle_frame, node, frame, t_ns, counts, chunk.t_ns, cause=cause)
        self._forward_signals(link, node, chunk.t_ns)

    def _handle_frame(
        self, node: NodeSession, frame: Frame, t_ns: int, link: LinkCounts, arrived_ns: int
    ) -> None:
        self.odometry.add_samples(node.handle_frame(frame, t_ns, link), node, arrived_ns)

    def _transmit(self, label: str, data: bytes, to: str) -> bool:
        sent: list[bool] = []
        self.bulkheads.run(
            f"sending on {label}", lambda: sent.append(self._send(label, data, to)), pausing=True
        )
        return any(sent)

    def _forward_signals(self, link: LinkSession, receiver: NodeSession, t_ns: int) -> None:
        """Forward the reports of a radio receiver to the nodes they are about."""
        signals, receiver.received_signals = receiver.received_signals, []
        for signal in signals:
            for node in self.nodes.on_link(link.label):
                if node.node_id == signal.of_node:
                    self.odometry.add_samples(node.update_signal(signal), node, t_ns)

    def _compare_firmware(self) -> None:
        difference = self.nodes.compare_firmware()
        if difference is not None:
            self.warn("recorder", difference)


def _part_name(node: NodeSession) -> str:
    """Return the name of a node's part in events and metrics."""
    return f"node {node.name}"
