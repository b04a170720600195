"""Forwarding of logged messages to Foxglove's live view: the same topics, the same bytes.

The package foxglove-sdk implements the protocol, with its own threads and a bounded backlog per client.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from hubodo.errors import InputError
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.output_thread import OutputThread
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.tee_sink import RecordListener
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import Log, LogMessage
from hubodo.log.mcap_file import Compression, MessageIndexes
from hubodo.log.records import LogRecord, stream_key
from hubodo.recording import Event
from hubodo.web.address import Address

if TYPE_CHECKING:
    import foxglove

_MESSAGE_HEADER = struct.Struct("<BQHIqq")
_MAX_BACKLOG = 8192
"""Queued writes, several seconds of four nodes; beyond that the oldest are dropped."""


class FoxgloveClients:
    """The Foxglove server and its channels; a `ChunkTarget` that sends messages to clients only."""

    path = Path()
    size = 0

    def __init__(self, address: Address) -> None:
        """Start the server; raise InputError if that is not possible."""
        if not address.is_loopback:
            raise InputError(
                f"{address}: Foxglove's protocol has no access control, so it is limited to this computer; "
                f"from another computer use ssh -L {address.port}:127.0.0.1:{address.port} HERE"
            )
        try:
            import foxglove
        except ImportError:
            raise InputError("foxglove-sdk is not installed; run pip install 'hubodo[foxglove]'") from None
        self.closed = False
        self._sdk = foxglove
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="hubodo", host=address.host, port=address.port, context=self._context
            )
        except (RuntimeError, OSError) as error:
            raise InputError(f"{address}: cannot serve Foxglove: {error}; give another port") from None
        no_schema = foxglove.Schema(name="", encoding="", data=b"")
        self._schemas: dict[int, foxglove.Schema] = {0: no_schema}
        self._channels: dict[int, foxglove.Channel] = {}

    @property
    def port(self) -> int:
        """Return the port of the server."""
        return self._server.port

    @property
    def has_subscribers(self) -> bool:
        """Return True if a client has subscribed to any topic."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema; see `ChunkTarget`."""
        number = len(self._schemas)
        self._schemas[number] = self._sdk.Schema(name=name, encoding=encoding, data=data)
        return number

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Add a channel; see `ChunkTarget`."""
        number = len(self._channels) + 1
        self._channels[number] = self._sdk.Channel(
            topic,
            schema=self._schemas[schema_id],
            message_encoding=encoding,
            metadata=dict(metadata),
            context=self._context,
        )
        return number

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Ignore metadata, which the protocol does not carry."""

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Ignore attachments, which the protocol does not carry."""

    def add_chunk(self, records: bytes, indexes: MessageIndexes, compression: Compression) -> None:
        """Send each message of a chunk."""
        offset, view = 0, memoryview(records)
        while offset < len(records):
            _, length, channel, _, t_log_ns, _ = _MESSAGE_HEADER.unpack_from(records, offset)
            self.send(channel, bytes(view[offset + _MESSAGE_HEADER.size : offset + 9 + length]), t_log_ns)
            offset += 9 + length

    def send(self, channel: int, payload: bytes, t_log_ns: int) -> None:
        """Send a message to the subscribers of its topic."""
        self._channels[channel].log(payload, log_time=t_log_ns)

    def finish(self) -> None:
        """Stop the server; see `ChunkTarget`."""
        if not self.closed:
            self.closed = True
            self._server.stop()


class FoxgloveLive:
    """An `Audience` that forwards a recording from its own thread; a context manager."""

    def __init__(self, address: Address) -> None:
        """Start the server; raise InputError if that is not possible."""
        self.clients = FoxgloveClients(address)
        self.startup_lines: list[str] = []
        """Lines that the recorder prints once for the user."""
        self._log = LogWriter(self.clients, clock=None)
        self._thread: OutputThread[LogRecord | None] | None = None
        self._known: set[tuple[Any, ...]] = set()
        self._wanted = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is None or self._thread.close():
            self._log.close()

    def attach(self, log: LogWriter, series: LogSeries, bulkheads: Bulkheads) -> Mapping[str, RecordListener]:
        """Return the listener that receives the messages written to the log."""
        self._thread = OutputThread("foxglove", lambda: self._handle, bulkheads, capacity=_MAX_BACKLOG)
        return {"foxglove": self.queue_write}

    def poll(self, recorder: Recorder, now_ns: int) -> None:
        """Report the startup lines and flush; see `Audience`."""
        recorder.notices += [Event(now_ns, "served", "web", line) for line in self.startup_lines]
        self.startup_lines = []
        if self._thread is not None:
            self._thread.put(None)

    def show(self, snapshot: Snapshot) -> None:
        """Ignore snapshots; see `Audience`."""

    def queue_write(self, record: LogRecord) -> None:
        """Queue a write to the log; see `hubodo.ingest.live.tee_sink.RecordListener`."""
        if self._thread is not None:
            self._thread.put(record)

    def _handle(self, record: LogRecord | None) -> None:
        """Forward a queued write; None, which arrives 50 times a second, flushes."""
        if record is None:
            self._log.flush()
            self._wanted = self.clients.has_subscribers
        else:
            self._write(record, self._wanted)

    def _write(self, record: LogRecord, wanted: bool) -> None:
        """Forward a write if a client wants it; the first of each channel always, to announce its topic."""
        key = stream_key(record)
        if wanted or key not in self._known:
            self._known.add(key)
            self._log.write_record(record)


class FoxgloveReplay:
    """A log replayed to clients: each message up to a time, once."""

    def __init__(self, clients: FoxgloveClients, log: Log, start_ns: int) -> None:
        self._clients = clients
        self._pending = log.messages(start=start_ns)
        # Some writers announce channels only inside chunks, so the first message comes first.
        self._next: LogMessage | None = next(self._pending, None)
        schemas = {
            schema.id: clients.add_schema(schema.name, schema.encoding, bytes(schema.data))
            for schema in log.scan.schemas.values()
        }
        self._channels = {
            channel.id: clients.add_channel(
                channel.topic,
                channel.message_encoding,
                schemas.get(channel.schema_id, 0),
                dict(channel.metadata),
            )
            for channel in log.scan.channels.values()
        }

    def send_until(self, t_ns: int) -> None:
        """Send the messages received until `t_ns`, host time."""
        while self._next is not None and self._next.log_time <= t_ns:
            channel = self._channels.get(self._next.channel)
            if channel is not None:
                self._clients.send(channel, self._next.data, self._next.log_time)
            self._next = next(self._pending, None)
