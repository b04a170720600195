"""Find the records of an MCAP file front to back, without trusting its index, its lengths or its end.

One way of reading serves whole, cut and damaged files. A length is believed only when it fits the file; after
a place that makes no sense the search goes on for the next chunk whose header is consistent in itself.
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
from hubodo.log.checksums import attachment_holds, data_section_holds
from hubodo.log.chunk_reader import ChunkPlace
from hubodo.log.descriptor import pread
from hubodo.log.input_limits import MemoryBudget, open_regular, room_of
from hubodo.log.mcap_file import MAGIC

_MAX_RECORD = 1 << 28
_LOOSE = 1 << 22
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_CHUNK_SIGN = re.compile(
    rb"(?=\x06.{5}\x00\x00\x00.{28}(?:\x00\x00\x00\x00|\x03\x00\x00\x00lz4|\x04\x00\x00\x00zstd))", re.DOTALL
)
_LEAST_WINDOW, _WINDOW = 1 << 12, 1 << 22
_DATA_MEMORY, _TEXT_MEMORY = 2, 16  # bytes of memory per byte of a record of data, and of one of short texts


@dataclass(frozen=True)
class DamagedSpan:
    """A stretch of the file that could not be used. start_ns, end_ns: of the messages lost, where known."""

    offset: int
    length: int
    reason: str
    start_ns: int | None = None
    end_ns: int | None = None


@dataclass
class Scan:
    """All records of one file but the messages; `cut` is the last chunk's place when the file ends in it.

    unbelievable: offsets of chunks that claim to hold more than a file of this size can. doubts: checksums
    that fail without telling where, each in words, of `data` (all up to the end of it) and `summary`.
    """

    path: Path
    size: int
    profile: str = ""
    library: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    chunks: list[ChunkPlace] = field(default_factory=list)
    damage: list[DamagedSpan] = field(default_factory=list)
    unbelievable: set[int] = field(default_factory=set)
    doubts: dict[str, str] = field(default_factory=dict)
    cut: ChunkPlace | None = None
    complete: bool = False
    _noted: set[int] = field(default_factory=set)

    def learn(self, definitions: Iterable[tuple[int, bytes]]) -> None:
        """Take in schemas and channels, as (opcode, content), that were found inside a chunk."""
        for opcode, content in definitions:
            record = _parse(opcode, content)
            if isinstance(record, Schema):
                self.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self.channels.setdefault(record.id, record)

    def note(self, place: ChunkPlace, reason: str) -> None:
        """Keep account of a chunk that cannot be used, once."""
        if place.offset not in self._noted:
            self._noted.add(place.offset)
            self.damage.append(DamagedSpan(place.offset, place.length, reason, place.start_ns, place.end_ns))


def scan(path: Path, *, lenient: bool = False) -> Scan:
    """Scan a file; `lenient` passes over damaged magic. LogError when it is missing, empty or no MCAP."""
    try:
        with open_regular(path) as stream:
            return _Scanner(path, stream.fileno()).run(lenient)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror}); check the path and its rights") from error


class _Scanner:
    def __init__(self, path: Path, fd: int) -> None:
        self.fd = fd
        self.found = Scan(path, os.fstat(fd).st_size)
        self.room = room_of(self.found.size)
        self.budget = MemoryBudget(path)
        self.header_end = len(MAGIC)
        self.data_ended = False

    def run(self, lenient: bool) -> Scan:
        found, size = self.found, self.found.size
        magic = pread(self.fd, len(MAGIC), 0)
        if not magic:
            raise LogError(f"{found.path}: is empty; nothing was recorded, or the copy failed")
        position = len(MAGIC)
        if magic != MAGIC:
            resumed = self._next_chunk(0) if lenient else None
            if resumed is None:
                raise LogError(
                    f"{found.path}: is not an MCAP file (begins with {magic!r}); "
                    "give a log made by hubodo or ROS 2"
                )
            found.damage.append(DamagedSpan(0, resumed, "the beginning is damaged"))
            position = resumed
        suspect = position
        while position < size and not found.complete:
            after, trusted = self._record(position)
            if after is None:
                resumed = self._next_chunk(suspect)
                if resumed is None:
                    self._tail(position)
                    break
                lost = DamagedSpan(position, resumed - position, "unreadable record")
                found.damage.append(lost)
                after, trusted = resumed, True
                suspect = resumed
            if trusted:
                suspect = after
            position = after
        if found.complete and not self.data_ended:
            found.doubts["data"] = "the mark at the end of its data is missing"
        return found

    def _record(self, position: int) -> tuple[int | None, bool]:
        """Take in a record; returns where the next begins (None: makes no sense) and whether that is sure."""
        head = pread(self.fd, 64, position)
        if len(head) < _HEAD.size:
            return None, False
        opcode, length = _HEAD.unpack_from(head)
        end = position + _HEAD.size + length
        if opcode == 0 or end > self.found.size:
            return None, False
        if opcode == Opcode.CHUNK:
            place = _chunk_place(head, position)
            if place is None or place.length > _HEAD.size + length:
                return None, False
            self._believe(place)
            return end, place.length == _HEAD.size + length
        if opcode == Opcode.MESSAGE:
            if length < 22:
                return None, False
            self._loose(position, end, int.from_bytes(head[15:23], "little"))
            return end, False
        if opcode == Opcode.DATA_END and length >= 4:
            stated = int.from_bytes(head[9:13], "little")
            self.data_ended = True
            if not data_section_holds(self.fd, (0, len(MAGIC), self.header_end), position, stated):
                self.found.doubts["data"] = "its checksum over all data fails"
            return end, False
        if opcode in _READERS:
            if length > _MAX_RECORD:
                return None, False
            return (end, False) if self._take(opcode, position, length) else (None, False)
        return end, False

    def _take(self, opcode: int, position: int, length: int) -> bool:
        ratio = _DATA_MEMORY if opcode in (Opcode.ATTACHMENT, Opcode.SCHEMA) else _TEXT_MEMORY
        self.budget.claim(ratio * length, "what stands beside its messages")
        content = pread(self.fd, length, position + _HEAD.size)
        found = self.found
        record = _parse(opcode, content)
        if record is None:
            return False
        if isinstance(record, Header):
            found.profile, found.library = record.profile, record.library
            self.header_end = position + _HEAD.size + length
        elif isinstance(record, Schema):
            found.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            found.channels.setdefault(record.id, record)
        elif isinstance(record, Metadata):
            found.metadata.append(record)
        elif isinstance(record, Attachment):
            if attachment_holds(content):
                found.attachments.append(record)
            else:
                reason = f"the attachment {record.name} fails its checksum"
                found.damage.append(DamagedSpan(position, _HEAD.size + length, reason))
        elif isinstance(record, Footer):
            end = position + _HEAD.size + length
            found.complete = pread(self.fd, len(MAGIC), end) == MAGIC
            self._trust_summary(record, position)
        return True

    def _trust_summary(self, footer: Footer, footer_at: int) -> None:
        """The summary repeats schemas and channels under a checksum: where that holds, it is believed."""
        size = footer_at - footer.summary_start
        if not footer.summary_crc:
            return
        sound = 0 < size <= _MAX_RECORD
        summary = pread(self.fd, size + _HEAD.size + 16, footer.summary_start) if sound else b""
        if zlib.crc32(summary) != footer.summary_crc:
            self.found.doubts["summary"] = "the checksum of its summary fails"
            return
        position = 0
        while position + _HEAD.size <= size:
            opcode, length = _HEAD.unpack_from(summary, position)
            content = summary[position + _HEAD.size : position + _HEAD.size + length]
            record = _parse(opcode, content)
            if isinstance(record, Schema):
                self.found.schemas[record.id] = record
            elif isinstance(record, Channel):
                self.found.channels[record.id] = record
            position += _HEAD.size + length

    def _believe(self, place: ChunkPlace) -> None:
        """Take in a chunk; one that claims more than is left for a file of this size is not opened."""
        self.found.chunks.append(place)
        if place.size <= self.room:
            self.room -= place.size
        else:
            self.found.unbelievable.add(place.offset)

    def _loose(self, position: int, end: int, time_ns: int) -> None:
        chunks = self.found.chunks
        last = chunks[-1] if chunks else None
        start_ns = end_ns = time_ns
        if (
            last
            and last.compression is None
            and last.offset + last.length == position
            and last.length < _LOOSE
        ):
            chunks.pop()
            position = last.offset
            start_ns, end_ns = min(last.start_ns, time_ns), max(last.end_ns, time_ns)
        size = end - position
        chunks.append(ChunkPlace(position, size, position, size, None, size, 0, start_ns, end_ns))

    def _tail(self, position: int) -> None:
        """The file ends within a record: note what is lost, and the chunk that was being written."""
        found = self.found
        place = _chunk_place(pread(self.fd, 64, position), position)
        start_ns = end_ns = None
        if place is not None:
            found.cut = place
            start_ns, end_ns = place.start_ns, place.end_ns
        found.damage.append(
            DamagedSpan(position, found.size - position, "the file ends within a record", start_ns, end_ns)
        )

    def _next_chunk(self, start: int) -> int | None:
        """The next place from `start` that begins a consistent chunk header whose data fits the file."""
        base, size = start, _LEAST_WINDOW
        while base < self.found.size:
            window = pread(self.fd, size + 64, base)
            for match in _CHUNK_SIGN.finditer(window):
                place = _chunk_place(window[match.start() : match.start() + 64], base + match.start())
                length = int.from_bytes(window[match.start() + 1 : match.start() + 9], "little")
                if (
                    place is not None
                    and place.length == _HEAD.size + length
                    and place.offset + place.length <= self.found.size
                    and match.start() < size
                ):
                    return place.offset
            base, size = base + size, min(2 * size, _WINDOW)
        return None


_READERS: Mapping[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.FOOTER: Footer.read,
}


def _chunk_place(head: bytes, offset: int) -> ChunkPlace | None:
    """What a chunk's header says, when it can be true."""
    at = _HEAD.size + _CHUNK_HEAD.size
    if len(head) < at or head[0] != Opcode.CHUNK:
        return None
    start, end, size, crc, name_length = _CHUNK_HEAD.unpack_from(head, _HEAD.size)
    if name_length > 16 or len(head) < at + name_length + 8:
        return None
    name = head[at : at + name_length].decode("latin-1")
    (data_size,) = struct.unpack_from("<Q", head, at + name_length)
    data_offset = offset + at + name_length + 8
    length = at + name_length + 8 + data_size
    return ChunkPlace(offset, length, data_offset, data_size, name, size, crc, start, end)


def _parse(opcode: int, content: bytes) -> McapRecord | None:
    """A record's content, or None when it makes no sense."""
    read = _READERS.get(opcode)
    if read is None:
        return None
    try:
        return read(ReadDataStream(io.BytesIO(content)))
    except (McapError, ValueError, struct.error, MemoryError, OverflowError):
        return None
