"""The raw frames of a log decoded again: what a recorder of today makes of what a recorder then has heard."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.atomic_files import atomic_new_file
from hubodo.errors import InputError, WireMismatch
from hubodo.ingest.link.ports import PortName, parse_port
from hubodo.ingest.link.session import DAMAGED_SUFFIX
from hubodo.ingest.node.bulk import BulkDecoder
from hubodo.ingest.node.naming import assign_name
from hubodo.ingest.node.node_frames import group_by_node
from hubodo.ingest.node.published import LogTimeSequence
from hubodo.ingest.node.session import NodeSession
from hubodo.log import ros2, topics
from hubodo.log.chunk_reader import Messages
from hubodo.log.decode import message_type
from hubodo.log.hubodo_messages import decode_bytes_message, decode_string_message, parse_events
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import Log, open_log
from hubodo.recording import Event
from hubodo.version import __version__
from hubowire import FrameDecoder, PayloadError, decode
from hubowire.messages import Hello

Progress = Callable[[str, float], None]

_PIECES = 20_000
_QUESTIONS = 16
_OF_NODES = (ros2.IMU, ros2.TEMPERATURE, ros2.BATTERY, ros2.MAGNETIC_FIELD)
_ODOMETRY = (topics.ODOM, topics.ODOM_MAP, topics.TF)
_MADE_AGAIN = ("gap", "reset", "health", "started", "mismatch")


@dataclass(frozen=True)
class DecodedAgain:
    """What became of the frames. nodes: name -> counts; messages: in the new log; warnings: of the old."""

    out: Path
    messages: int
    nodes: dict[str, dict[str, Any]]
    warnings: tuple[str, ...]


def decode_again(path: Path, out: Path, *, progress: Progress | None = None) -> DecodedAgain:
    """Writes a log with the raw frames of another, decoded by this version.

    Samples, temperatures, supplies, fields, the nodes' own biases, gaps and clocks are made anew from the
    frames and from the questions that the recorder sent; GNSS, links and attachments are taken over;
    odometry is left to `hubodo fuse`. Raises LogError for what is no log, InputError when it holds no raw
    frames or `out` exists, WireMismatch when every node speaks another version.
    """
    with open_log(path) as log, atomic_new_file(out) as part:
        records = {
            name: values for name, values in log.metadata_records.items() if not name.startswith("node.")
        }
        main = {k: v for k, v in records.pop(topics.METADATA_RECORD, {}).items() if k != topics.T_ZERO_KEY}
        main |= {"decoded_from": path.name, "decoded_by": f"hubodo {__version__}"}
        with LogWriter(part, metadata=main, t_zero_ns=log.t_zero_ns or 0, clock=None) as target:
            for name, values in records.items():
                target.add_metadata(name, values)
            for file in log.scan.attachments:
                target.add_attachment(file.name, file.media_type, bytes(file.data))
            again = _Again(log, target, _ports(main.get("ports", "")))
            for messages in log.chunks():
                again.take(messages)
                if progress:
                    progress(f"decoding {path.name}", log.progress)
            nodes = again.finish()
        if not again.links:
            raise InputError(f"{path}: holds no raw frames; only what `hubodo record` wrote does")
        refused = [text for session in again.sessions() if (text := session.decoder.mismatch_text)]
        if refused and len(refused) == len(nodes):
            raise WireMismatch("; ".join(refused))
        warnings = log.warnings()
    return DecodedAgain(out, target.message_count, nodes, warnings)


def _ports(text: str) -> dict[str, PortName]:
    """The ports of a recording by their label."""
    return {port.label: port for port in map(parse_port, text.split())}


class _Again:
    """Goes through the messages of a log in the order in which they were written."""

    def __init__(self, log: Log, target: LogWriter, ports: dict[str, PortName]) -> None:
        self.links: dict[str, _Link] = {}
        self._log, self._target, self._ports = log, target, ports
        self._names: set[str] = set()
        self._known: dict[tuple[str, int, bytes], NodeSession] = {}
        self._copied: dict[int, int] = {}

    def take(self, messages: Messages) -> None:
        """The messages of one chunk."""
        streams = self._log.streams
        rows = zip(messages.heads["channel"].tolist(), messages.heads["log_time"].tolist(), strict=True)
        for row, (channel, t_ns) in enumerate(rows):
            stream = streams.get(channel)
            if stream is None:
                continue
            topic = stream.topic
            if topic.startswith(topics.RAW_PREFIX):
                self._raw(
                    topic.removeprefix(topics.RAW_PREFIX),
                    t_ns,
                    decode_bytes_message(stream.encoding, messages.payload(row)),
                )
            elif topic.startswith(topics.CLOCK_REQUEST_PREFIX):
                token = decode_bytes_message(stream.encoding, messages.payload(row))
                label = topic.removeprefix(topics.CLOCK_REQUEST_PREFIX)
                self._target.write_clock_request(label, t_ns, token)
                for link in self._beside(label) or [self._link(label)]:
                    link.asked(token, t_ns)
            elif topic == topics.EVENTS:
                for event in parse_events([decode_string_message(stream.encoding, messages.payload(row))])[0]:
                    self._event(event)
            elif (
                topic not in _ODOMETRY
                and message_type(stream.schema) not in _OF_NODES
                and not topic.endswith("/bias_filter")
            ):
                t_pub_ns = int(messages.heads["publish_time"][row])
                self._target.write(self._channel(channel), t_ns, t_pub_ns, messages.payload(row))

    def finish(self) -> dict[str, dict[str, Any]]:
        """Decodes what waits; the counts of each node."""
        for link in self.links.values():
            link.decode()
        for session in self.sessions():
            _ = list(session.close(max(link.last_ns for link in self.links.values())))
        return {
            session.name: {
                "link": session.link,
                "node_id": session.node_id,
                "frames": session.decoder.counts.frames,
                "frames_lost": session.decoder.counts.frames_lost,
                "frames_unread": session.decoder.counts.frames_undecoded,
                "samples": session.decoder.counts.samples,
                "samples_lost": session.decoder.counts.samples_lost,
                "refused": session.decoder.mismatch_text,
                "clock": session.clock.estimate().as_json(),
            }
            for session in self.sessions()
        }

    def sessions(self) -> Iterator[NodeSession]:
        """All nodes, each once: one that was restarted may have come from two senders."""
        found = {id(node): node for link in self.links.values() for node in link.sessions.values()}
        yield from found.values()

    def _beside(self, label: str) -> list[_Link]:
        """A link, and what its other senders have sent."""
        return [link for place, link in self.links.items() if place.partition("/")[0] == label]

    def _link(self, place: str) -> _Link:
        if place not in self.links:
            label = place.partition("/")[0]
            for link in self._beside(label):
                link.decode()
            self.links[place] = _Link(label, self._ports.get(label), self._target, self._names, self._known)
        return self.links[place]

    def _raw(self, name: str, t_ns: int, piece: bytes) -> None:
        self._target.write_raw_frame(name, t_ns, piece)
        self._link(name.removesuffix(DAMAGED_SUFFIX)).piece(
            piece, t_ns, damaged=name.endswith(DAMAGED_SUFFIX)
        )

    def _event(self, event: Event) -> None:
        for link in self._beside(event.source):
            if event.kind == "connected":
                link.open = True
            elif event.kind == "disconnected":
                link.lost()
        begin_ns = event.data.get("begin_ns") if event.kind == "clock" else None
        if begin_ns is not None:
            for link in self.links.values():
                link.resumed(begin_ns, event.t_ns)
        of_node = event.kind in _MADE_AGAIN or (event.kind == "clock" and "node" in event.data)
        if not of_node and event.source not in ("odometry", "map"):
            self._target.write_event(event)

    def _channel(self, number: int) -> int:
        if number not in self._copied:
            found = self._log.scan
            channel = found.channels[number]
            schema = found.schemas.get(channel.schema_id)
            name, encoding, data = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
            self._copied[number] = self._target.add_channel(
                channel.topic, name, encoding, data, channel.message_encoding, channel.metadata
            )
        return self._copied[number]


class _Link:
    """The pieces of one link, decoded in portions.

    A portion ends where the link was lost, before and after a new start of a node, and where as many
    questions wait for their answers as a node's session keeps.
    """

    def __init__(
        self,
        label: str,
        port: PortName | None,
        target: LogWriter,
        names: set[str],
        known: dict[tuple[str, int, bytes], NodeSession],
    ) -> None:
        """known: sessions by link, node id and serial, of all senders."""
        self.open = True
        self.sessions: dict[int, NodeSession] = {}
        self._label, self._target, self._names, self._known = label, target, names, known
        self._serials: dict[int, bytes] = {}
        self._wanted = port.name if port is not None else None
        self._datagrams = port is not None and port.kind == "udp"
        self._decoder = BulkDecoder()
        self._heads = FrameDecoder()
        self._boots: dict[int, int] = {}
        self._pieces: list[bytes] = []
        self._times: list[int] = []
        self._marks: list[bool] = []
        self._asked: list[tuple[bytes, int]] = []
        self._damaged = self._downs = self.last_ns = 0

    def piece(self, piece: bytes, t_ns: int, *, damaged: bool) -> None:
        """Bytes up to a delimiter."""
        starts = not damaged and len(piece) > 2 and piece[1] == Hello.type_id and self._new_start(piece)
        if starts:
            self.decode()
        self._pieces.append(piece if piece.endswith(b"\0") else piece + b"\0")
        self._times.append(t_ns)
        self._marks.append(damaged)
        if starts or len(self._pieces) >= _PIECES:
            self.decode()

    def asked(self, token: bytes, t_ns: int) -> None:
        """A question about a clock."""
        self._asked.append((token, t_ns))
        if len(self._asked) >= _QUESTIONS:
            self.decode()

    def resumed(self, begin_ns: int, end_ns: int) -> None:
        """The computer stood still between these host times."""
        self.decode()
        for session in self.sessions.values():
            session.decoder.note_host_suspension(begin_ns, end_ns)

    def lost(self) -> None:
        """The link has gone, if it was there."""
        self.decode()
        self._downs += self.open
        self.open = False

    def _new_start(self, piece: bytes) -> bool:
        frame = self._heads.decode(piece.removesuffix(b"\0"))
        try:
            hello = decode(frame.type_id, frame.payload) if frame is not None else None
        except PayloadError:
            return False
        if frame is None or not isinstance(hello, Hello):
            return False
        before = self._boots.get(frame.node)
        self._boots[frame.node] = hello.boot_id
        self._serials[frame.node] = hello.serial
        return before != hello.boot_id

    def decode(self) -> None:
        """What waits."""
        if not self._pieces:
            return
        ends = np.cumsum([len(piece) for piece in self._pieces]) + self._decoder.bytes_in
        times, damaged = np.array(self._times), np.cumsum(self._marks) + self._damaged

        def arrival(end: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
            rows = np.searchsorted(ends, end)
            return times[rows], damaged[rows]

        found = group_by_node(self._decoder.feed(b"".join(self._pieces)), arrival)
        for node_id in found:
            if node_id not in self.sessions:
                self.sessions[node_id] = self._session(node_id)
        for token, t_ns in self._asked:
            for session in self.sessions.values():
                session.add_clock_request(token, t_ns)
        self.last_ns, self._damaged = int(times[-1]), int(damaged[-1])
        for node_id, some in found.items():
            self.sessions[node_id].handle_frames(some, self._downs)
        for session in self.sessions.values():
            _ = list(session.resolve_gaps(self.last_ns))
        self._pieces, self._times, self._marks, self._asked = [], [], [], []

    def _session(self, node_id: int) -> NodeSession:
        key = (self._label, node_id, self._serials.get(node_id, b""))
        if not self._datagrams or not key[2]:
            return self._made(node_id)
        if key not in self._known:
            self._known[key] = self._made(node_id)
        return self._known[key]

    def _made(self, node_id: int) -> NodeSession:
        name, _ = assign_name(self._wanted, node_id, self._names)
        self._names.add(name)
        return NodeSession(
            name,
            self._label,
            node_id,
            lambda question: False,
            self._target,
            lambda: self.last_ns,
            datagrams=self._datagrams,
            clock_period=1.0,
            order=LogTimeSequence(),
        )
