"""Find the records of an MCAP file front to back, without trusting its index, lengths or footer.

Complete, truncated and damaged files are read in the same manner. A length is used only if it fits the file;
after an undecodable record the search continues with the next chunk whose header is self-consistent.
"""

from __future__ import annotations

import io
import os
import re
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Footer, Header, McapRecord, Metadata, Schema

from hubodo.errors import LogError
from hubodo.log.chunk_reader import ChunkLocation
from hubodo.log.descriptor import pread
from hubodo.log.input_limits import READ_BLOCK_BYTES, MemoryBudget, max_expanded_bytes, open_regular
from hubodo.log.mcap_file import MAGIC
from hubodo.spelling import explain_missing_file

_MAX_RECORD_BYTES = 1 << 28
_MAX_UNCHUNKED_RUN_BYTES = 1 << 22
_RECORD_HEADER = struct.Struct("<BQ")
_CHUNK_HEADER = struct.Struct("<QQQII")
_CHUNK_HEADER_PATTERN = re.compile(
    rb"(?=\x06.{5}\x00\x00\x00.{28}(?:\x00\x00\x00\x00|\x03\x00\x00\x00lz4|\x04\x00\x00\x00zstd))", re.DOTALL
)
_MIN_SEARCH_BYTES, _MAX_SEARCH_BYTES = 1 << 12, 1 << 22
_DATA_MEMORY_RATIO, _TEXT_MEMORY_RATIO = 2, 16
"""Bytes of memory per byte of a record with data, and of a record with many short texts."""


@dataclass(frozen=True)
class DamagedSpan:
    """A damaged part of the file, in bytes. start_ns, end_ns: log times of the lost messages, if known."""

    offset: int
    length: int
    reason: str
    start_ns: int | None = None
    end_ns: int | None = None


@dataclass
class FileScan:
    """All records of one file except the messages.

    Attributes
    ----------
    chunks : positions of the complete chunks; see `ChunkLocation`.
    damage : parts that could not be used.
    oversized_chunks : offsets of chunks whose claimed size is implausible for the file.
    checksum_failures : descriptions of failed checksums that do not locate the damage, by section: `data`
        (everything up to the data end record) and `summary`.
    truncated_chunk : the last chunk if the file ends within it.
    complete : True if the file ends with footer and magic.
    """

    path: Path
    size: int
    profile: str = ""
    library: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    chunks: list[ChunkLocation] = field(default_factory=list)
    damage: list[DamagedSpan] = field(default_factory=list)
    oversized_chunks: set[int] = field(default_factory=set)
    checksum_failures: dict[str, str] = field(default_factory=dict)
    truncated_chunk: ChunkLocation | None = None
    complete: bool = False
    _damaged_offsets: set[int] = field(default_factory=set)

    def add_definitions(self, definitions: Iterable[tuple[int, bytes]]) -> None:
        """Add schemas and channels, as (opcode, content), that are stored inside a chunk."""
        for opcode, content in definitions:
            record = _parse_record(opcode, content)
            if isinstance(record, Schema):
                self.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self.channels.setdefault(record.id, record)

    def mark_damaged(self, location: ChunkLocation, reason: str) -> None:
        """Record a damaged chunk, once."""
        if location.offset not in self._damaged_offsets:
            self._damaged_offsets.add(location.offset)
            self.damage.append(
                DamagedSpan(location.offset, location.length, reason, location.start_ns, location.end_ns)
            )


def scan_file(path: Path, *, lenient: bool = False) -> FileScan:
    """Scan a file. lenient: accept damaged magic. Raises LogError if it is missing, empty or not MCAP."""
    try:
        with open_regular(path) as stream:
            return _Scanner(path, stream.fileno()).run(lenient)
    except IsADirectoryError:
        raise LogError(f"{path}: is a folder, and an MCAP file is due here; name the file") from None
    except OSError as error:
        reason = f"cannot be read ({error.strerror}); check the path and its rights"
        raise LogError(explain_missing_file(path, reason)) from error


class _Scanner:
    def __init__(self, path: Path, fd: int) -> None:
        self.fd = fd
        self.result = FileScan(path, os.fstat(fd).st_size)
        self.expansion_left = max_expanded_bytes(self.result.size)
        self.budget = MemoryBudget(path)
        self.header_end = len(MAGIC)
        self.data_ended = False

    def run(self, lenient: bool) -> FileScan:
        result, size = self.result, self.result.size
        magic = pread(self.fd, len(MAGIC), 0)
        if not magic:
            raise LogError(f"{result.path}: is empty; nothing was recorded, or the copy failed")
        position = len(MAGIC)
        if magic != MAGIC:
            resumed = self._find_next_chunk(0) if lenient else None
            if resumed is None:
                raise LogError(
                    f"{result.path}: is not an MCAP file (begins with {magic!r}); "
                    "give a log made by hubodo or ROS 2"
                )
            result.damage.append(DamagedSpan(0, resumed, "the beginning is damaged"))
            position = resumed
        suspect = position
        while position < size and not result.complete:
            after, trusted = self._read_record(position)
            if after is None:
                resumed = self._find_next_chunk(suspect)
                if resumed is None:
                    self._mark_truncated(position)
                    break
                lost = DamagedSpan(position, resumed - position, "unreadable record")
                result.damage.append(lost)
                after, trusted = resumed, True
                suspect = resumed
            if trusted:
                suspect = after
            position = after
        if result.complete and not self.data_ended:
            result.checksum_failures["data"] = "the mark at the end of its data is missing"
        return result

    def _read_record(self, position: int) -> tuple[int | None, bool]:
        """Read a record; return the offset of the next (None: undecodable) and whether it is confirmed."""
        header = pread(self.fd, 64, position)
        if len(header) < _RECORD_HEADER.size:
            return None, False
        opcode, length = _RECORD_HEADER.unpack_from(header)
        end = position + _RECORD_HEADER.size + length
        if opcode == 0 or end > self.result.size:
            return None, False
        if opcode == Opcode.CHUNK:
            location = _parse_chunk_header(header, position)
            if location is None or location.length > _RECORD_HEADER.size + length:
                return None, False
            self._add_chunk(location)
            return end, location.length == _RECORD_HEADER.size + length
        if opcode == Opcode.MESSAGE:
            if length < 22:
                return None, False
            self._add_unchunked_message(position, end, int.from_bytes(header[15:23], "little"))
            return end, False
        if opcode == Opcode.DATA_END and length >= 4:
            stated = int.from_bytes(header[9:13], "little")
            self.data_ended = True
            if not _data_section_crc_matches(self.fd, (0, len(MAGIC), self.header_end), position, stated):
                self.result.checksum_failures["data"] = "its checksum over all data fails"
            return end, False
        if opcode in _RECORD_READERS:
            if length > _MAX_RECORD_BYTES:
                return None, False
            return (end, False) if self._add_record(opcode, position, length) else (None, False)
        return end, False

    def _add_record(self, opcode: int, position: int, length: int) -> bool:
        ratio = _DATA_MEMORY_RATIO if opcode in (Opcode.ATTACHMENT, Opcode.SCHEMA) else _TEXT_MEMORY_RATIO
        self.budget.claim(ratio * length, "the records beside its messages")
        content = pread(self.fd, length, position + _RECORD_HEADER.size)
        result = self.result
        record = _parse_record(opcode, content)
        if record is None:
            return False
        if isinstance(record, Header):
            result.profile, result.library = record.profile, record.library
            self.header_end = position + _RECORD_HEADER.size + length
        elif isinstance(record, Schema):
            result.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            result.channels.setdefault(record.id, record)
        elif isinstance(record, Metadata):
            result.metadata.append(record)
        elif isinstance(record, Attachment):
            if _attachment_crc_matches(content):
                result.attachments.append(record)
            else:
                reason = f"the attachment {record.name} fails its checksum"
                result.damage.append(DamagedSpan(position, _RECORD_HEADER.size + length, reason))
        elif isinstance(record, Footer):
            end = position + _RECORD_HEADER.size + length
            result.complete = pread(self.fd, len(MAGIC), end) == MAGIC
            self._read_summary(record, position)
        return True

    def _read_summary(self, footer: Footer, footer_at: int) -> None:
        """Use the schemas and channels of the summary if its checksum matches."""
        size = footer_at - footer.summary_start
        if not footer.summary_crc:
            return
        is_plausible = 0 < size <= _MAX_RECORD_BYTES
        summary = (
            pread(self.fd, size + _RECORD_HEADER.size + 16, footer.summary_start) if is_plausible else b""
        )
        if zlib.crc32(summary) != footer.summary_crc:
            self.result.checksum_failures["summary"] = "the checksum of its summary fails"
            return
        position = 0
        while position + _RECORD_HEADER.size <= size:
            opcode, length = _RECORD_HEADER.unpack_from(summary, position)
            content = summary[position + _RECORD_HEADER.size : position + _RECORD_HEADER.size + length]
            record = _parse_record(opcode, content)
            if isinstance(record, Schema):
                self.result.schemas[record.id] = record
            elif isinstance(record, Channel):
                self.result.channels[record.id] = record
            position += _RECORD_HEADER.size + length

    def _add_chunk(self, location: ChunkLocation) -> None:
        """Add a chunk; one whose claimed size is implausible for the file is marked as oversized."""
        self.result.chunks.append(location)
        if location.expanded_size <= self.expansion_left:
            self.expansion_left -= location.expanded_size
        else:
            self.result.oversized_chunks.add(location.offset)

    def _add_unchunked_message(self, position: int, end: int, time_ns: int) -> None:
        chunks = self.result.chunks
        last = chunks[-1] if chunks else None
        start_ns = end_ns = time_ns
        if (
            last
            and last.compression is None
            and last.offset + last.length == position
            and last.length < _MAX_UNCHUNKED_RUN_BYTES
        ):
            chunks.pop()
            position = last.offset
            start_ns, end_ns = min(last.start_ns, time_ns), max(last.end_ns, time_ns)
        size = end - position
        chunks.append(ChunkLocation(position, size, position, size, None, size, 0, start_ns, end_ns))

    def _mark_truncated(self, position: int) -> None:
        """Record the damage of a file that ends within a record, and the chunk being written if any."""
        result = self.result
        location = _parse_chunk_header(pread(self.fd, 64, position), position)
        start_ns = end_ns = None
        if location is not None:
            result.truncated_chunk = location
            start_ns, end_ns = location.start_ns, location.end_ns
        result.damage.append(
            DamagedSpan(position, result.size - position, "the file ends within a record", start_ns, end_ns)
        )

    def _find_next_chunk(self, start: int) -> int | None:
        """Return the next offset from `start` of a consistent chunk header whose data fits the file."""
        base, size = start, _MIN_SEARCH_BYTES
        while base < self.result.size:
            window = pread(self.fd, size + 64, base)
            for match in _CHUNK_HEADER_PATTERN.finditer(window):
                location = _parse_chunk_header(
                    window[match.start() : match.start() + 64], base + match.start()
                )
                length = int.from_bytes(window[match.start() + 1 : match.start() + 9], "little")
                if (
                    location is not None
                    and location.length == _RECORD_HEADER.size + length
                    and location.offset + location.length <= self.result.size
                    and match.start() < size
                ):
                    return location.offset
            base, size = base + size, min(2 * size, _MAX_SEARCH_BYTES)
        return None


_RECORD_READERS: Mapping[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.FOOTER: Footer.read,
}


def _parse_chunk_header(header: bytes, offset: int) -> ChunkLocation | None:
    """Parse a chunk header; return None if it is inconsistent."""
    fixed_size = _RECORD_HEADER.size + _CHUNK_HEADER.size
    if len(header) < fixed_size or header[0] != Opcode.CHUNK:
        return None
    start, end, size, crc, name_length = _CHUNK_HEADER.unpack_from(header, _RECORD_HEADER.size)
    if name_length > 16 or len(header) < fixed_size + name_length + 8:
        return None
    name = header[fixed_size : fixed_size + name_length].decode("latin-1")
    (data_size,) = struct.unpack_from("<Q", header, fixed_size + name_length)
    data_offset = offset + fixed_size + name_length + 8
    length = fixed_size + name_length + 8 + data_size
    return ChunkLocation(offset, length, data_offset, data_size, name, size, crc, start, end)


def _parse_record(opcode: int, content: bytes) -> McapRecord | None:
    """Parse the content of a record; return None if it is undecodable."""
    read = _RECORD_READERS.get(opcode)
    if read is None:
        return None
    try:
        return read(ReadDataStream(io.BytesIO(content)))
    except (McapError, ValueError, struct.error, MemoryError, OverflowError):
        return None


def _attachment_crc_matches(content: bytes) -> bool:
    """Return True if an attachment record matches the CRC in its last four bytes, or if that is 0 (none)."""
    expected_crc = int.from_bytes(content[-4:], "little")
    return not expected_crc or zlib.crc32(content[:-4]) == expected_crc


def _data_section_crc_matches(fd: int, starts: Iterable[int], end: int, expected_crc: int) -> bool:
    """Return True if the bytes up to offset `end` match the expected CRC, or if that is 0 (not given).

    starts: offsets at which the CRC may begin: most writers use the first byte of the file, some the first
    after the magic bytes or the header.
    """
    return not expected_crc or any(_compute_crc(fd, start, end) == expected_crc for start in starts)


def _compute_crc(fd: int, start: int, end: int) -> int:
    crc = 0
    while start < end and (block := pread(fd, min(READ_BLOCK_BYTES, end - start), start)):
        crc = zlib.crc32(block, crc)
        start += len(block)
    return crc
