"""Decoding of the raw frames of a log by this version, into a new log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.atomic_files import atomic_new_file
from hubodo.errors import InputError, WireMismatch
from hubodo.ingest.link.ports import PortName, parse_port
from hubodo.ingest.link.session import DAMAGED_SUFFIX
from hubodo.ingest.node.naming import RecordedNames
from hubodo.ingest.node.session import NodeSession
from hubodo.ingest.replay.link_redecoder import LinkRedecoder
from hubodo.log import ros2, topics
from hubodo.log.chunk_reader import ChunkMessages
from hubodo.log.decode import normalise_type_name
from hubodo.log.hubodo_messages import decode_bytes_message, decode_string_message, parse_events
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import Log, open_log
from hubodo.progress_callback import Progress
from hubodo.recording import Event
from hubodo.version import __version__

_NODE_MESSAGE_TYPES = (ros2.IMU, ros2.TEMPERATURE, ros2.BATTERY, ros2.MAGNETIC_FIELD)
_ODOMETRY_TOPICS = (topics.ODOM, topics.ODOM_MAP, topics.TF)
_REGENERATED_KINDS = ("gap", "reset", "health", "started", "mismatch")


@dataclass(frozen=True)
class RedecodedLog:
    """Result of decoding a log; nodes: counters by name; messages: number in the new log."""

    out: Path
    messages: int
    nodes: dict[str, dict[str, Any]]
    warnings: tuple[str, ...]


def redecode_log(path: Path, out: Path, *, progress: Progress | None = None) -> RedecodedLog:
    """Write a log with the raw frames of another, decoded by this version.

    Samples, temperatures, supply voltages, magnetic fields, bias filter reports, gaps and clocks are computed
    from the frames and the recorded clock requests; GNSS, link events and attachments are copied; odometry is
    omitted (see `hubodo fuse`). Raises LogError for an invalid log, InputError when it holds no raw frames or
    `out` exists, WireMismatch when every node uses another protocol version.
    """
    with open_log(path) as log, atomic_new_file(out) as part:
        records = {
            name: values
            for name, values in log.metadata_records.items()
            if not name.startswith(topics.NODE_RECORD_PREFIX)
        }
        metadata = {
            k: v for k, v in records.pop(topics.METADATA_RECORD, {}).items() if k != topics.T_ZERO_KEY
        }
        metadata |= {"decoded_from": path.name, "decoded_by": f"hubodo {__version__}"}
        with LogWriter(part, metadata=metadata, t_zero_ns=log.t_zero_ns or 0, clock=None) as target:
            for name, values in records.items():
                target.add_metadata(name, values)
            for file in log.scan.attachments:
                target.add_attachment(file.name, file.media_type, bytes(file.data))
            redecoder = _LogRedecoder(log, target, _parse_ports(metadata.get("ports", "")))
            for messages in log.chunks():
                redecoder.handle_messages(messages)
                if progress:
                    progress(f"decoding {path.name}", log.progress)
            nodes = redecoder.finish()
        if not redecoder.links:
            raise InputError(
                f"{path}: holds no raw frames, so nothing can be decoded; it is a log that every verb reads"
            )
        mismatches = [text for session in redecoder.sessions() if (text := session.decoder.mismatch_text)]
        if mismatches and len(mismatches) == len(nodes):
            raise WireMismatch("; ".join(mismatches))
        warnings = log.warnings()
    return RedecodedLog(out, target.message_count, nodes, warnings)


def _parse_ports(text: str) -> dict[str, PortName]:
    """Return the ports of a recording by label."""
    return {port.label: port for port in map(parse_port, text.split())}


class _LogRedecoder:
    """Decodes or copies the messages of a log in the order in which they were written."""

    def __init__(self, log: Log, target: LogWriter, ports: dict[str, PortName]) -> None:
        self.links: dict[str, LinkRedecoder] = {}
        self._log, self._target, self._ports = log, target, ports
        self._names = RecordedNames(log.metadata_records)
        self._sessions_by_serial: dict[tuple[str, int, bytes], NodeSession] = {}
        self._copied_channels: dict[int, int] = {}

    def handle_messages(self, messages: ChunkMessages) -> None:
        """Handle the messages of one chunk."""
        streams = self._log.streams
        rows = zip(messages.headers["channel"].tolist(), messages.headers["log_time"].tolist(), strict=True)
        for row, (channel, t_ns) in enumerate(rows):
            stream = streams.get(channel)
            if stream is None:
                continue
            topic = stream.topic
            if topic.startswith(topics.RAW_PREFIX):
                self._handle_raw(
                    topic.removeprefix(topics.RAW_PREFIX),
                    t_ns,
                    decode_bytes_message(stream.encoding, messages.payload(row)),
                )
            elif topic.startswith(topics.CLOCK_REQUEST_PREFIX):
                token = decode_bytes_message(stream.encoding, messages.payload(row))
                label = topic.removeprefix(topics.CLOCK_REQUEST_PREFIX)
                self._target.write_clock_request(label, t_ns, token)
                for link in self._links_of(label) or [self._get_or_create_link(label)]:
                    link.add_clock_request(token, t_ns)
            elif topic == topics.EVENTS:
                for event in parse_events([decode_string_message(stream.encoding, messages.payload(row))])[0]:
                    self._handle_event(event)
            elif (
                topic not in _ODOMETRY_TOPICS
                and normalise_type_name(stream.schema) not in _NODE_MESSAGE_TYPES
                and not topic.endswith("/bias_filter")
            ):
                t_pub_ns = int(messages.headers["publish_time"][row])
                self._target.write(self._copy_channel(channel), t_ns, t_pub_ns, messages.payload(row))

    def finish(self) -> dict[str, dict[str, Any]]:
        """Decode all pending pieces and return the counters of each node."""
        for link in self.links.values():
            link.decode_pending(is_final=True)
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
        """Yield each node once; a restarted node may have used two senders."""
        unique = {id(node): node for link in self.links.values() for node in link.sessions.values()}
        yield from unique.values()

    def _links_of(self, label: str) -> list[LinkRedecoder]:
        """Return the decoders of all senders of a link."""
        return [link for topic, link in self.links.items() if topic.partition("/")[0] == label]

    def _get_or_create_link(self, topic: str) -> LinkRedecoder:
        if topic not in self.links:
            label = topic.partition("/")[0]
            for link in self._links_of(label):
                link.decode_pending()
            self.links[topic] = LinkRedecoder(
                label, self._ports.get(label), self._target, self._names, self._sessions_by_serial
            )
        return self.links[topic]

    def _handle_raw(self, name: str, t_ns: int, piece: bytes) -> None:
        self._target.write_raw_frame(name, t_ns, piece)
        self._get_or_create_link(name.removesuffix(DAMAGED_SUFFIX)).add_piece(
            piece, t_ns, is_damaged=name.endswith(DAMAGED_SUFFIX)
        )

    def _handle_event(self, event: Event) -> None:
        for link in self._links_of(event.source):
            if event.kind == "connected":
                link.is_open = True
            elif event.kind == "disconnected":
                link.handle_lost()
        start_ns = event.data.get("begin_ns") if event.kind == "clock" else None
        if start_ns is not None:
            for link in self.links.values():
                link.note_host_suspension(start_ns, event.t_ns)
        of_node = event.kind in _REGENERATED_KINDS or (event.kind == "clock" and "node" in event.data)
        if not of_node and event.source not in ("odometry", "map"):
            self._target.write_event(event)

    def _copy_channel(self, number: int) -> int:
        if number not in self._copied_channels:
            scan = self._log.scan
            channel = scan.channels[number]
            schema = scan.schemas.get(channel.schema_id)
            name, encoding, data = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
            self._copied_channels[number] = self._target.add_channel(
                channel.topic, name, encoding, data, channel.message_encoding, channel.metadata
            )
        return self._copied_channels[number]
