"""Collect messages into chunks and write each chunk when it is full or old enough.

A message waits in memory until its chunk is full or half a second old, whichever comes first; then the chunk
goes to the operating system in one call. The age is checked on each write and on `tick()`, so a killed
process loses at most the messages of the last `pending_s` plus the time between two ticks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hubodo.log import ros2, topics
from hubodo.log.mcap_file import Compression, McapFile, MessageIndexes
from hubodo.log.message_records import MAX_PENDING_ROWS, RowBuffer, encode_message_record
from hubodo.units import NS_PER_S

_ROW_NUMBERS = np.arange(MAX_PENDING_ROWS, dtype=np.uint32)


class _ChannelIndex:
    """Log times and record offsets of one channel's messages in the pending chunk."""

    def __init__(self) -> None:
        self.batches: list[tuple[NDArray[np.int64], int, int]] = []
        self.times: list[int] = []
        self.offsets: list[int] = []

    def drain(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        times = [batch for batch, _, _ in self.batches]
        offsets = [first + size * np.arange(len(batch)) for batch, first, size in self.batches]
        if self.times:
            times.append(np.array(self.times, np.int64))
            offsets.append(np.array(self.offsets, np.int64))
        self.batches, self.times, self.offsets = [], [], []
        return np.concatenate(times), np.concatenate(offsets)

    def __bool__(self) -> bool:
        return bool(self.batches or self.times)


class ChunkTarget(Protocol):
    """The destination of chunks: one file, or a series of files."""

    @property
    def path(self) -> Path: ...

    @property
    def size(self) -> int: ...

    @property
    def closed(self) -> bool: ...

    def add_schema(self, name: str, encoding: str, data: bytes) -> int: ...

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int: ...

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None: ...

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None: ...

    def add_chunk(self, records: bytes, indexes: MessageIndexes, compression: Compression) -> None: ...

    def finish(self) -> None: ...


class ChunkWriter:
    """A writer of messages, single or in batches of one layout; a context manager for one thread.

    Parameters
    ----------
    path : the file to create (InputError if it exists), or another destination of chunks.
    metadata : text by key, stored in the metadata record `hubodo`.
    t_zero_ns : host time that readers call t = 0; by default the present whole second.
    compression : zstd, lz4 or none.
    chunk_bytes, pending_s : a chunk is written when it has this size or its first message this age.
    clock : monotonic clock in ns for that age; None disables the age limit (bulk conversion).
    """

    def __init__(
        self,
        path: Path | ChunkTarget,
        *,
        metadata: Mapping[str, str] | None = None,
        t_zero_ns: int | None = None,
        compression: Compression = "zstd",
        chunk_bytes: int = 1 << 20,
        pending_s: float = 0.5,
        clock: Callable[[], int] | None = time.monotonic_ns,
    ) -> None:
        self.t_zero_ns = time.time_ns() // NS_PER_S * NS_PER_S if t_zero_ns is None else t_zero_ns
        self.compression: Compression = compression
        self._file: ChunkTarget = McapFile(path) if isinstance(path, Path) else path
        self._file.add_metadata(
            topics.METADATA_RECORD, {**dict(metadata or {}), topics.T_ZERO_KEY: str(self.t_zero_ns)}
        )
        self._chunk_bytes = chunk_bytes
        self._pending_ns = int(pending_s * NS_PER_S)
        self._clock = clock
        self._flush_deadline_ns: int | None = None
        self._records: list[bytes] = []
        self._records_size = 0  # bytes in _records
        self._pending_streams: list[RowBuffer] = []  # row buffers whose rows are not in _records yet
        self._pending_rows_size = 0
        self._index: dict[int, _ChannelIndex] = {}
        self._next_sequence: dict[int, int] = {}
        self._message_count = 0
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[str, int] = {}
        self._streams: dict[str, RowBuffer] = {}

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self._file.path

    @property
    def size(self) -> int:
        """Bytes handed to the operating system."""
        return self._file.size

    @property
    def message_count(self) -> int:
        """Messages accepted, including pending ones."""
        return self._message_count

    def add_channel(
        self,
        topic: str,
        schema: str,
        schema_encoding: str,
        definition: bytes,
        encoding: str,
        metadata: Mapping[str, str] | None = None,
    ) -> int:
        """Announce a channel and return its id. An empty `schema` name means a channel without schema."""
        schema_id = 0
        if schema:
            key = (schema, schema_encoding)
            if key not in self._schemas:
                self._schemas[key] = self._file.add_schema(schema, schema_encoding, definition)
            schema_id = self._schemas[key]
        channel = self._file.add_channel(topic, encoding, schema_id, metadata or {})
        self._channels[topic] = channel
        self._next_sequence[channel] = 0
        self._index[channel] = _ChannelIndex()
        return channel

    def add_ros2_channel(self, topic: str, schema: str, metadata: Mapping[str, str] | None = None) -> int:
        """Announce a channel with a message type of `ros2` and return its id."""
        return self.add_channel(topic, schema, "ros2msg", ros2.definition(schema).encode(), "cdr", metadata)

    def write(self, channel: int, t_log_ns: int, t_pub_ns: int, payload: bytes) -> None:
        """Write one message. Times are ns since 1970; ValueError if negative."""
        if t_log_ns < 0 or t_pub_ns < 0:
            raise ValueError(f"negative time: log {t_log_ns} ns, publish {t_pub_ns} ns")
        sequence = self._next_sequence[channel]
        self._next_sequence[channel] = sequence + 1
        self._message_count += 1
        index = self._index[channel]
        index.times.append(t_log_ns)
        index.offsets.append(self._records_size)
        self._records.append(encode_message_record(channel, sequence, t_log_ns, t_pub_ns, payload))
        self._records_size += len(self._records[-1])
        self._flush_if_due()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write another metadata record."""
        self._file.add_metadata(name, values)

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file to the log, such as a configuration or calibration."""
        self._file.add_attachment(name, media_type, data, self.t_zero_ns)

    def tick(self, now_ns: int | None = None) -> None:
        """Write the pending chunk if its first message is old enough; to be called about every 0.1 s."""
        if self._flush_deadline_ns is None or self._clock is None:
            return
        if (self._clock() if now_ns is None else now_ns) >= self._flush_deadline_ns:
            self.flush()

    def flush(self) -> None:
        """Hand the pending chunk to the operating system. An OSError (disk full) loses only that chunk."""
        for stream in self._pending_streams:
            self._encode_pending_rows(stream)
        self._pending_streams = []
        if not self._records:
            return
        records = b"".join(self._records)
        indexes = {channel: index.drain() for channel, index in self._index.items() if index}
        self._records, self._records_size, self._flush_deadline_ns = [], 0, None
        self._file.add_chunk(records, indexes, self.compression)

    def close(self) -> None:
        """Write the pending chunk, the index and the footer. Idempotent."""
        if not self._file.closed:
            try:
                self.flush()
            finally:
                self._file.finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write_rows(
        self, stream: RowBuffer, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, values: Mapping[str, ArrayLike]
    ) -> None:
        """Write a batch: times (n,) ns or one for all; values: field -> (n, ...) or a scalar for all."""
        published = np.asarray(t_pub_ns, np.int64)
        if not published.ndim:
            published = published.reshape(1)
        count = len(published)
        if count > MAX_PENDING_ROWS:
            self._write_slabs(stream, published, t_log_ns, values)
            return
        if count == 0:
            return
        if stream.n_filled + count > MAX_PENDING_ROWS:
            self._encode_pending_rows(stream)
        rows = slice(stream.n_filled, stream.n_filled + count)
        logged = stream.log_time[rows]
        logged[:] = t_log_ns
        stream.publish_time[rows] = published
        log_ns: Any = t_log_ns
        has_one_log_time = isinstance(log_ns, int) and log_ns >= 0
        # The bitwise or is negative if either time is.
        if np.minimum.reduce(published if has_one_log_time else logged | published) < 0:
            raise ValueError(f"negative time: log {logged.min()} ns, publish {published.min()} ns")
        views = stream.field_views
        for path, value in values.items():
            view, array = views[path] if path in views else stream.field_view(path), np.asarray(value)
            if array.ndim and array.shape != (count, *view.shape[1:]):
                raise ValueError(f"{path} has shape {array.shape}, not {(count, *view.shape[1:])}")
            view[rows] = array
        if not stream.n_filled:
            self._pending_streams.append(stream)
        stream.n_filled = rows.stop
        self._message_count += count
        self._pending_rows_size += count * stream.record_size
        self._flush_if_due()

    def _encode_pending_rows(self, stream: RowBuffer) -> None:
        """Append the pending rows to the records, with sequence numbers and stamps."""
        count, stream.n_filled = stream.n_filled, 0
        if not count:
            return
        first = self._next_sequence[stream.channel]
        self._next_sequence[stream.channel] = first + count
        # uint32 wraps by itself, as the sequence field of the format does.
        stream.sequence[:count] = _ROW_NUMBERS[:count] + np.uint32(first & 0xFFFFFFFF)
        if stream.seconds is not None and stream.nanoseconds is not None:
            seconds, nanoseconds = np.divmod(stream.publish_time[:count], NS_PER_S)
            stream.seconds[:count], stream.nanoseconds[:count] = seconds, nanoseconds
        times = stream.log_time[:count].copy()
        self._index[stream.channel].batches.append((times, self._records_size, stream.record_size))
        self._records.append(stream.rows[:count].tobytes())
        self._records_size += count * stream.record_size
        self._pending_rows_size -= count * stream.record_size

    def _write_slabs(
        self,
        stream: RowBuffer,
        published: NDArray[np.int64],
        t_log_ns: ArrayLike,
        values: Mapping[str, ArrayLike],
    ) -> None:
        arrays = {path: np.asarray(value) for path, value in values.items()}
        logged = np.asarray(t_log_ns, np.int64)
        for first in range(0, len(published), MAX_PENDING_ROWS):
            part = slice(first, first + MAX_PENDING_ROWS)
            self.write_rows(
                stream,
                published[part],
                logged[part] if logged.ndim else logged,
                {path: value[part] if value.ndim else value for path, value in arrays.items()},
            )

    def _flush_if_due(self) -> None:
        if self._records_size + self._pending_rows_size >= self._chunk_bytes:
            self.flush()
        elif self._clock is not None:
            now = self._clock()
            if self._flush_deadline_ns is None:
                self._flush_deadline_ns = now + self._pending_ns
            elif now >= self._flush_deadline_ns:
                self.flush()
