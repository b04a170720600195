"""Write an MCAP file: records, chunks, indexes and footer, independent of message types.

Each call hands complete records to the operating system at once, so a killed process leaves complete records.
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
from hubodo.log.descriptor import create_append_only
from hubodo.version import __version__

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "ros2"
LIBRARY = f"hubodo {__version__}"

Compression = Literal["zstd", "lz4", "none"]
MessageIndexes = Mapping[int, tuple[NDArray[np.int64], NDArray[np.int64]]]
FileState = Literal["in place", "moved", "deleted", "modified"]
"""State of the open file on disk; "modified": its size differs from what was written."""


class McapFile:
    """A new MCAP file, open for writing until `finish()`. Raises InputError if the path exists."""

    def __init__(self, path: Path, *, profile: str = PROFILE, library: str = LIBRARY) -> None:
        try:
            self._fd = create_append_only(path)
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
        self._chunk_indexes = bytearray()  # encoded, because a log of weeks has millions of chunks
        self._chunk_count = 0
        self._attachment_indexes: list[AttachmentIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._start: int | None = None
        self._end = 0
        self.append_records(MAGIC + _encode(Header(profile=profile, library=library)))

    @property
    def closed(self) -> bool:
        """True after `finish()` or `close_without_footer()`."""
        return self._fd < 0

    @property
    def message_count(self) -> int:
        """Messages in the chunks written so far."""
        return sum(self._counts.values())

    def append_records(self, *parts: bytes | bytearray) -> None:
        """Append complete records; on failure (disk full) the file is truncated to its previous size."""
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
        """Write a schema record and return its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self.copy_schema(schema)
        return schema.id

    def copy_schema(self, schema: Schema) -> None:
        """Write a schema record of another file under its own id."""
        self.append_records(_encode(schema))
        self._schemas[schema.id] = schema

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Write a channel record outside any chunk, where chunk damage cannot reach it, and return its id."""
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
        """Write an attachment record, such as a configuration or calibration file."""
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
        """Write message records as one chunk with its message indexes, in one system call.

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
            self.close()

    def write_footer(self) -> None:
        """Write summary, footer and closing magic; on failure (disk full) none of them."""
        end = _encode(DataEnd(data_section_crc=self._data_crc))
        self.append_records(end, *self._encode_summary(self.size + len(end)))

    def file_state(self) -> FileState:
        """Return the state of the open file: unchanged, or moved, deleted or modified by another program."""
        opened = os.fstat(self._fd)
        if opened.st_size != self.size:
            return "modified"
        try:
            named = self.path.stat()
            if (named.st_ino, named.st_dev) == (opened.st_ino, opened.st_dev):
                return "in place"
        except OSError:
            pass  # no such name, or its folder cannot be reached
        return "moved" if opened.st_nlink else "deleted"

    def duplicate_descriptor(self) -> int:
        """Return a second descriptor of the open file, which the caller must close."""
        return os.dup(self._fd)

    def close(self) -> None:
        """Close the file without summary and footer. Idempotent."""
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
        """Return summary and footer in parts, because the index of a long log is too large to copy."""
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
        header = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc = 0
        for part in (*parts, offsets, header):
            crc = zlib.crc32(part, crc)
        footer = Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc)
        return [*parts, offsets, _encode(footer) + MAGIC]


def describe_loss(file: McapFile) -> str | None:
    """Return why messages of an open log are lost; None if the file is intact."""
    match file.file_state():
        case "deleted":
            why = (
                f"was deleted or replaced while it was written; {file.message_count} messages in it are lost"
            )
        case "modified":
            why = (
                f"was shortened or written to by another program; up to {file.message_count} messages in it "
                "are lost (hubodo recover saves the remaining ones)"
            )
        case _:
            return None
    return f"{file.path}: {why}"


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
    header = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel_id, entries.nbytes)
    return header + entries.tobytes()
