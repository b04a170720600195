"""The inside of a chunk: decompressed within bounds, checked, and its messages found."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from hubodo.log.descriptor import pread
from hubodo.log.input_limits import room_of
from hubodo.log.message_records import MESSAGE_HEADER

MAX_CHUNK = 1 << 30
"""Bytes; a chunk that claims to be bigger is taken for damaged before anything is allocated for it."""
MEMORY_PER_BYTE = 4
"""Bytes of memory that a byte of a chunk takes while its messages are located: of the shortest, 3.5."""
_HEAD = struct.Struct("<BQ")
_INDEX = struct.Struct("<BQHI")


@dataclass(frozen=True)
class ChunkPlace:
    """Where a chunk stands; crc 0: not given. A run of messages outside chunks has `compression` None."""

    offset: int
    length: int
    data_offset: int
    data_size: int
    compression: str | None
    size: int
    crc: int
    start_ns: int
    end_ns: int


class DamagedChunk(Exception):
    """A chunk whose bytes are not what was written; str() is the reason."""


def load(fd: int, place: ChunkPlace) -> bytes:
    """The records of a chunk. Raises DamagedChunk; allocates no more than the chunk can truly hold."""
    if place.size > MAX_CHUNK or place.data_size > MAX_CHUNK:
        raise DamagedChunk(f"claims {max(place.size, place.data_size)} bytes")
    data = pread(fd, place.data_size, place.data_offset)
    if len(data) != place.data_size:
        raise DamagedChunk("is cut off")
    if place.compression is None:
        return data
    try:
        data = _decompress(data, place.compression, place.size)
    except (zstandard.ZstdError, RuntimeError, MemoryError, ValueError) as error:
        raise DamagedChunk(f"does not decompress ({error})") from error
    if len(data) != place.size:
        raise DamagedChunk(f"holds {len(data)} bytes instead of {place.size}")
    if place.crc and zlib.crc32(data) != place.crc:
        raise DamagedChunk("fails its checksum")
    return data


def load_cut(fd: int, place: ChunkPlace) -> bytes:
    """What still decompresses of a chunk that the file's end cut off; may be empty, fails no checksum."""
    data = pread(fd, min(place.data_size, MAX_CHUNK), place.data_offset)
    bound = min(place.size, MAX_CHUNK, room_of(len(data)))
    try:
        if place.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)).read(bound)
        elif place.compression == "lz4":
            data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, bound))
        elif place.compression != "":
            return b""
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        return b""
    damaged = len(data) >= place.size and place.crc and zlib.crc32(data) != place.crc
    return b"" if damaged else data


def _decompress(data: bytes, compression: str, size: int) -> bytes:
    if compression == "zstd":
        if zstandard.frame_content_size(data) not in (-1, size):
            raise DamagedChunk("contradicts itself about its size")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=max(size, 1))
    if compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1))
    if compression == "":
        return data
    raise DamagedChunk(f"uses the compression {compression!r}, which hubodo does not know")


@dataclass(frozen=True)
class Messages:
    """The messages of one chunk, in file order.

    data: (size,) uint8, the chunk's records. places: (n,) where each record begins. heads: (n,) of dtype
    `chunks.PREFIX`. definitions: (opcode, content) of schema and channel records. whole: False when the
    records end in nonsense.
    """

    data: NDArray[np.uint8]
    places: NDArray[np.int64]
    heads: NDArray[np.void]
    definitions: tuple[tuple[int, bytes], ...]
    whole: bool

    def between(self, start_ns: int, end_ns: int) -> Messages:
        """Those with start_ns <= log time <= end_ns."""
        times = self.heads["log_time"]
        chosen = (times >= start_ns) & (times <= end_ns)
        return replace(self, places=self.places[chosen], heads=self.heads[chosen])

    def by_channel(self) -> Iterator[tuple[int, NDArray[np.intp]]]:
        """Yield each channel id and the indices of its messages, in one pass over the chunk."""
        channels = np.ascontiguousarray(self.heads["channel"])
        order = np.argsort(channels, kind="stable")
        ids, starts = np.unique(channels[order], return_index=True)
        yield from zip(ids.tolist(), np.split(order, starts[1:]), strict=False)

    def size_of(self, chosen: NDArray[np.intp]) -> int:
        """Return the bytes of the records of these messages."""
        return int(self.heads["length"][chosen].sum())

    def payload(self, i: int) -> bytes:
        """Bytes of message i."""
        start = int(self.places[i]) + MESSAGE_HEADER.itemsize
        return self.data[start : start + int(self.heads["length"][i]) - 22].tobytes()


def announced(fd: int, place: ChunkPlace) -> NDArray[np.int64]:
    """Where the message indexes behind a chunk say that its records begin, in order."""
    found, position = [], place.offset + place.length
    while place.compression is not None:
        head = pread(fd, _INDEX.size, position)
        if len(head) < _INDEX.size:
            break
        opcode, length, _, size = _INDEX.unpack(head)
        if opcode != Opcode.MESSAGE_INDEX or length != size + 6 or size % 16 or size > place.size:
            break
        entries = pread(fd, size, position + _INDEX.size)
        if len(entries) < size:
            break
        found.append(np.frombuffer(entries, "<i8")[1::2])
        position += _INDEX.size + size
    return np.sort(np.concatenate(found)) if found else np.empty(0, np.int64)


def walk(data: bytes, announced: NDArray[np.int64] | None = None) -> Messages:
    """Find the messages among a chunk's records; stops where they make no sense.

    announced: where they may begin. It is believed where one record ends at the next from the first byte to
    the last, which is quicker to see than to find.
    """
    if announced is not None and len(announced):
        heads = _chained(data, announced)
        if heads is not None:
            return Messages(np.frombuffer(data, np.uint8), announced, heads, (), True)
    parts: list[NDArray[np.int64]] = []
    single: list[int] = []
    definitions: dict[tuple[int, bytes], bytes] = {}
    position, end, run, last = 0, len(data), 0, -1
    unpack = _HEAD.unpack_from
    while position + _HEAD.size <= end:
        opcode, length = unpack(data, position)
        after = position + _HEAD.size + length
        if after > end or opcode == 0 or (opcode == Opcode.MESSAGE and length < 22):
            break
        if opcode == Opcode.MESSAGE:
            single.append(position)
            run = run + 1 if length == last else 0
            last = length
            if run == 8:
                stride = _HEAD.size + length
                count = _equal_run(data, after, stride)
                parts += [np.array(single, np.int64), after + stride * np.arange(count)]
                single, run = [], 0
                after += count * stride
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            start = position + _HEAD.size
            definitions.setdefault((opcode, data[start : start + 2]), data[start:after])
        position = after
    places = np.concatenate([*parts, np.array(single, np.int64)])
    defined = tuple((opcode, content) for (opcode, _), content in definitions.items())
    return Messages(np.frombuffer(data, np.uint8), places, _heads(data, places), defined, position == end)


def _chained(data: bytes, places: NDArray[np.int64]) -> NDArray[np.void] | None:
    """The heads of message records at these places, if they are all there is."""
    if places[0] != 0 or places[-1] > len(data) - MESSAGE_HEADER.itemsize:
        return None
    heads = _heads(data, places)
    lengths = heads["length"].astype(np.int64)
    sound = (heads["opcode"] == Opcode.MESSAGE) & (lengths >= 22)
    sound &= places + _HEAD.size + lengths == np.append(places[1:], len(data))
    return heads if sound.all() else None


def _heads(data: bytes, places: NDArray[np.int64]) -> NDArray[np.void]:
    if not len(places):
        return np.empty(0, MESSAGE_HEADER)
    anywhere: NDArray[np.void] = np.ndarray(
        (len(data) - MESSAGE_HEADER.itemsize + 1,), MESSAGE_HEADER, buffer=data, strides=(1,)
    )
    return anywhere[places]


def _equal_run(data: bytes, start: int, stride: int) -> int:
    """How many message records of one size follow back to back."""
    count, look = 0, 64
    while (room := min(look, (len(data) - start) // stride - count)) > 0:
        heads: NDArray[np.void] = np.ndarray(
            (room,), MESSAGE_HEADER, buffer=data, offset=start + count * stride, strides=(stride,)
        )
        same = (heads["opcode"] == 5) & (heads["length"] == stride - 9)
        if not bool(same.all()):
            return count + int(same.argmin())
        count, look = count + room, look * 4
    return count
