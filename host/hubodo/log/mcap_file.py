"""The MCAP file being written: records, chunks, indexes, footer; knows bytes and offsets, no message types.

Every call hands complete records to the operating system at once, so a killed process leaves whole records.
Format: https://mcap.dev/spec (version 0); record layouts come from the `mcap` package's own classes.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.descriptor import open_new
from hubodo.version import __version__

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "ros2"
LIBRARY = f"hubodo {__version__}"

Compression = Literal["zstd", "lz4", "none"]
MessageIndexes = Mapping[int, tuple[NDArray[np.int64], NDArray[np.int64]]]
FileState = Literal["here", "elsewhere", "nowhere", "changed"]
"""A file still has its name, has only another one, was deleted, or has another size than was written."""


class McapFile:
    """A new MCAP file; refuses to overwrite (`InputError`). Usable up to `finish()`, then closed."""

    def __init__(self, path: Path, *, profile: str = PROFILE, library: str = LIBRARY) -> None:
        try:
            self._fd = open_new(path)
        except FileExistsError:
            raise InputError(
                f"{path}: exists already; choose another name or remove it, nothing is overwritten"
            ) from None
        except (FileNotFoundError, NotADirectoryError):
            raise InputError(f"{path}: its folder does not exist; create it first") from None
        self.path = path
        self.size = 0
        self._data_crc = 0
        self._zstd = zstandard.ZstdCompressor(level=1)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: dict[int, int] = {}
        self._chunk_indexes = bytearray()  # encoded: of a log of weeks there are millions
        self._chunk_count = 0
        self._attachment_indexes: list[AttachmentIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._start: int | None = None
        self._end = 0
        self.append_records(MAGIC + _encode(Header(profile=profile, library=library)))

    @property
    def closed(self) -> bool:
        """Whether `finish()` or `abandon()` was called."""
        return self._fd < 0

    @property
    def message_count(self) -> int:
        """Messages in the chunks written so far."""
        return sum(self._counts.values())

    def append_records(self, *parts: bytes | bytearray) -> None:
        """Append complete records, all of them; on failure (disk full) none, the file is cut back."""
        try:
            for part in parts:
                done = 0
                while done < len(part):
                    done += os.write(self._fd, memoryview(part)[done:])
        except OSError:
            os.ftruncate(self._fd, self.size)
            raise
        for part in parts:
            self.size += len(part)
            self._data_crc = zlib.crc32(part, self._data_crc)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Write a schema record; returns its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self.copy_schema(schema)
        return schema.id

    def copy_schema(self, schema: Schema) -> None:
        """Write a schema record of another file under its own id."""
        self.append_records(_encode(schema))
        self._schemas[schema.id] = schema

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Write a channel record, outside any chunk, so a damaged chunk takes none along; returns its id."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema_id,
            metadata=dict(metadata),
        )
        self.copy_channel(channel)
        return channel.id

    def copy_channel(self, channel: Channel) -> None:
        """Write a channel record of another file under its own id."""
        self.append_records(_encode(channel))
        self._channels[channel.id] = channel

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        data = _encode(Metadata(name=name, metadata=dict(values)))
        self._metadata_indexes.append(MetadataIndex(offset=self.size, length=len(data), name=name))
        self.append_records(data)

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Write a file into the log: a configuration, a calibration."""
        record = Attachment(
            create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data
        )
        encoded = _encode(record)
        self._attachment_indexes.append(
            AttachmentIndex(
                offset=self.size,
                length=len(encoded),
                log_time=time_ns,
                create_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self.append_records(encoded)

    def add_chunk(self, records: bytes, indexes: MessageIndexes, compression: Compression) -> None:
        """Write message records as one chunk with its message indexes, in one call to the system.

        records: message records back to back. indexes: by channel id the log times (n,) in ns and the
        offsets (n,) of the records within `records`.
        """
        name, data = self._compress(records, compression)
        start = min(int(times.min()) for times, _ in indexes.values())
        end = max(int(times.max()) for times, _ in indexes.values())
        chunk = _encode(
            Chunk(
                compression=name,
                data=data,
                message_start_time=start,
                message_end_time=end,
                uncompressed_crc=zlib.crc32(records),
                uncompressed_size=len(records),
            )
        )
        parts, offsets, position = [chunk], {}, self.size + len(chunk)
        for channel_id, (times, places) in indexes.items():
            offsets[channel_id] = position
            parts.append(_encode_message_index(channel_id, times, places))
            position += len(parts[-1])
        chunk_start = self.size
        self.append_records(b"".join(parts))
        self._chunk_count += 1
        self._chunk_indexes += _encode(
            ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=chunk_start,
                compression=name,
                compressed_size=len(data),
                message_end_time=end,
                message_index_length=self.size - chunk_start - len(chunk),
                message_index_offsets=offsets,
                message_start_time=start,
                uncompressed_size=len(records),
            )
        )
        self._start = start if self._start is None else min(self._start, start)
        self._end = max(self._end, end)
        for channel_id, (times, _) in indexes.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + len(times)

    def finish(self) -> None:
        """Write summary, footer and closing magic, and close. Idempotent."""
        if self.closed:
            return
        try:
            self.write_footer()
        finally:
            self.close_without_footer()

    def write_footer(self) -> None:
        """Write summary, footer and closing magic, all or, on failure (disk full), nothing of them."""
        end = _encode(DataEnd(data_section_crc=self._data_crc))
        self.append_records(end, *self._encode_summary(self.size + len(end)))

    def file_state(self) -> FileState:
        """Return what other programs have done to the file since it was opened."""
        ours = os.fstat(self._fd)
        if ours.st_size != self.size:
            return "changed"
        try:
            found = self.path.stat()
            if (found.st_ino, found.st_dev) == (ours.st_ino, ours.st_dev):
                return "here"
        except OSError:
            pass  # no such name, or its folder cannot be reached
        return "elsewhere" if ours.st_nlink else "nowhere"

    def duplicate_descriptor(self) -> int:
        """Another descriptor of the open file, to be closed by who asked for it."""
        return os.dup(self._fd)

    def close_without_footer(self) -> None:
        """Close the file as it stands, without a footer. Idempotent."""
        if not self.closed:
            fd, self._fd = self._fd, -1
            os.close(fd)

    def _compress(self, data: bytes, compression: Compression) -> tuple[str, bytes]:
        if compression == "zstd":
            return "zstd", self._zstd.compress(data)
        if compression == "lz4":
            return "lz4", bytes(lz4.frame.compress(data))
        if compression == "none":
            return "", data
        raise ValueError(f"compression {compression!r} is not one of zstd, lz4, none")

    def _encode_summary(self, start: int) -> list[bytes | bytearray]:
        """Return summary and footer in parts, because the index of a long log is too large to be copied."""
        statistics = Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunk_count,
            message_count=self.message_count,
            message_end_time=self._end,
            message_start_time=self._start or 0,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, bytes | bytearray]] = [
            (Opcode.SCHEMA, _encode_all(self._schemas.values())),
            (Opcode.CHANNEL, _encode_all(self._channels.values())),
            (Opcode.STATISTICS, _encode(statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, _encode_all(self._attachment_indexes)),
            (Opcode.METADATA_INDEX, _encode_all(self._metadata_indexes)),
        ]
        parts: list[bytes | bytearray] = [encoded for _, encoded in groups if encoded]
        offsets, position = b"", start
        for opcode, encoded in groups:
            if encoded:
                offset_record = SummaryOffset(
                    group_opcode=opcode, group_start=position, group_length=len(encoded)
                )
                offsets += _encode(offset_record)
                position += len(encoded)
        offset_start = position
        # The summary CRC covers the footer up to its own field.
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = 0
        for part in (*parts, offsets, head):
            crc = zlib.crc32(part, crc)
        footer = Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc)
        return [*parts, offsets, _encode(footer) + MAGIC]


def _encode(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _encode_all(records: Iterable[McapRecord]) -> bytes:
    return b"".join(map(_encode, records))


def _encode_message_index(channel_id: int, times: NDArray[np.int64], offsets: NDArray[np.int64]) -> bytes:
    if len(times) > 1 and bool((times[1:] < times[:-1]).any()):
        order = np.argsort(times, kind="stable")
        times, offsets = times[order], offsets[order]
    entries = np.empty((len(times), 2), "<i8")
    entries[:, 0], entries[:, 1] = times, offsets
    head = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel_id, entries.nbytes)
    return head + entries.tobytes()
