"""What goes into a log, also to Foxglove's live view: the same topics, the same bytes.

The package foxglove-sdk speaks the protocol, with threads of its own and a bounded backlog for each client.
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

_HEAD = struct.Struct("<BQHIqq")
_BACKLOG = 8192
"""Writes that wait for the thread: some seconds of four nodes; beyond them the oldest are dropped."""


class FoxgloveClients:
    """The server and its channels; `ChunkTarget` of a log whose messages go to the clients alone."""

    path = Path()
    size = 0

    def __init__(self, address: Address) -> None:
        """Raises InputError where it cannot be served."""
        if not address.loopback:
            raise InputError(
                f"{address}: Foxglove's protocol asks nobody for a token, so it is for this computer alone; "
                f"from another one: ssh -L {address.port}:127.0.0.1:{address.port} HERE"
            )
        try:
            import foxglove
        except ImportError:
            raise InputError("foxglove-sdk is not installed; say pip install 'hubodo[foxglove]'") from None
        self.closed = False
        self._sdk = foxglove
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="hubodo", host=address.host, port=address.port, context=self._context
            )
        except (RuntimeError, OSError) as error:
            raise InputError(f"{address}: cannot serve Foxglove there: {error}; name another port") from None
        nothing = foxglove.Schema(name="", encoding="", data=b"")
        self._schemas: dict[int, foxglove.Schema] = {0: nothing}
        self._channels: dict[int, foxglove.Channel] = {}

    @property
    def port(self) -> int:
        """That it listens on."""
        return self._server.port

    @property
    def wanted(self) -> bool:
        """Whether a client has asked for any topic."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """See `ChunkTarget`."""
        number = len(self._schemas)
        self._schemas[number] = self._sdk.Schema(name=name, encoding=encoding, data=data)
        return number

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """See `ChunkTarget`."""
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
        """Clients have no place for it."""

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Clients have no place for it."""

    def add_chunk(self, records: bytes, indexes: MessageIndexes, compression: Compression) -> None:
        """Sends each message."""
        at, view = 0, memoryview(records)
        while at < len(records):
            _, length, channel, _, t_log_ns, _ = _HEAD.unpack_from(records, at)
            self.send(channel, bytes(view[at + _HEAD.size : at + 9 + length]), t_log_ns)
            at += 9 + length

    def send(self, channel: int, payload: bytes, t_log_ns: int) -> None:
        """One message to those who asked for its topic."""
        self._channels[channel].log(payload, log_time=t_log_ns)

    def finish(self) -> None:
        """Ends the server."""
        if not self.closed:
            self.closed = True
            self._server.stop()


class FoxgloveLive:
    """An `Audience` that passes a recording on from a thread of its own; a context manager."""

    def __init__(self, address: Address) -> None:
        """Raises InputError where it cannot be served."""
        self.clients = FoxgloveClients(address)
        self.greetings: list[str] = []
        """Lines for the user of the recorder, shown once."""
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
        """See `Audience`."""
        self._thread = OutputThread("foxglove", lambda: self._handle, bulkheads, capacity=_BACKLOG)
        return {"foxglove": self.hear}

    def poll(self, recorder: Recorder, now_ns: int) -> None:
        """See `Audience`."""
        recorder.notices += [Event(now_ns, "served", "web", line) for line in self.greetings]
        self.greetings = []
        if self._thread is not None:
            self._thread.put(None)

    def show(self, snapshot: Snapshot) -> None:
        """See `Audience`."""

    def hear(self, record: LogRecord) -> None:
        """See `hubodo.ingest.live.tee_sink.RecordListener`."""
        if self._thread is not None:
            self._thread.put(record)

    def _handle(self, record: LogRecord | None) -> None:
        """Pass on a record; None, which comes fifty times a second, sends what is pending."""
        if record is None:
            self._log.flush()
            self._wanted = self.clients.wanted
        else:
            self._write(record, self._wanted)

    def _write(self, record: LogRecord, wanted: bool) -> None:
        """Write a record if a client wants it; the first of each channel always, to announce its topic."""
        key = stream_key(record)
        if wanted or key not in self._known:
            self._known.add(key)
            self._log.write_record(record)


class FoxgloveLog:
    """A log played to clients: what it holds up to a time, each message once."""

    def __init__(self, clients: FoxgloveClients, log: Log, start_ns: int) -> None:
        self._clients = clients
        self._coming = log.messages(start=start_ns)
        self._next: LogMessage | None = next(self._coming, None)  # some announce channels in chunks alone
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

    def up_to(self, t_ns: int) -> None:
        """Sends what was received until then, host time."""
        while self._next is not None and self._next.log_time <= t_ns:
            channel = self._channels.get(self._next.channel)
            if channel is not None:
                self._clients.send(channel, self._next.data, self._next.log_time)
            self._next = next(self._coming, None)
