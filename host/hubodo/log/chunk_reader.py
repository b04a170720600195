"""Decompress the chunks of an MCAP file within bounds, check them and locate their messages."""

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
from hubodo.log.input_limits import max_expanded_bytes
from hubodo.log.message_records import MESSAGE_HEADER

MAX_CHUNK_BYTES = 1 << 30
"""Bytes; a chunk that claims more is treated as damaged before anything is allocated."""
CHUNK_MEMORY_RATIO = 4
"""Bytes of memory per byte of a chunk while its messages are located; 3.5 for the shortest messages."""
_RECORD_HEADER = struct.Struct("<BQ")
_INDEX_HEADER = struct.Struct("<BQHI")


@dataclass(frozen=True)
class ChunkLocation:
    """The position and header of a chunk, or of a run of messages outside chunks (`compression` None).

    Attributes
    ----------
    offset, length : position and size of the chunk record in the file, bytes.
    data_offset, data_size : position and size of the compressed records in the file, bytes.
    expanded_size : size of the decompressed records, bytes, as claimed by the header.
    crc : CRC-32 of the decompressed records; 0 if not given.
    start_ns, end_ns : log time of the first and last message.
    """

    offset: int
    length: int
    data_offset: int
    data_size: int
    compression: str | None
    expanded_size: int
    crc: int
    start_ns: int
    end_ns: int


class DamagedChunk(Exception):
    """A damaged chunk; str() is the reason."""


def read_chunk(fd: int, location: ChunkLocation) -> bytes:
    """Return the decompressed records of a chunk, within its claimed size. Raises DamagedChunk."""
    if location.expanded_size > MAX_CHUNK_BYTES or location.data_size > MAX_CHUNK_BYTES:
        raise DamagedChunk(f"claims {max(location.expanded_size, location.data_size)} bytes")
    data = pread(fd, location.data_size, location.data_offset)
    if len(data) != location.data_size:
        raise DamagedChunk("is cut off")
    if location.compression is None:
        return data
    try:
        data = _decompress(data, location.compression, location.expanded_size)
    except (zstandard.ZstdError, RuntimeError, MemoryError, ValueError) as error:
        raise DamagedChunk(f"does not decompress ({error})") from error
    if len(data) != location.expanded_size:
        raise DamagedChunk(f"holds {len(data)} bytes instead of {location.expanded_size}")
    if location.crc and zlib.crc32(data) != location.crc:
        raise DamagedChunk("fails its checksum")
    return data


def read_truncated_chunk(fd: int, location: ChunkLocation) -> bytes:
    """Return the records that decompress from a chunk truncated by the end of the file; may be empty."""
    data = pread(fd, min(location.data_size, MAX_CHUNK_BYTES), location.data_offset)
    bound = min(location.expanded_size, MAX_CHUNK_BYTES, max_expanded_bytes(len(data)))
    try:
        if location.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)).read(bound)
        elif location.compression == "lz4":
            data = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, bound))
        elif location.compression != "":
            return b""
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        return b""
    damaged = len(data) >= location.expanded_size and location.crc and zlib.crc32(data) != location.crc
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
class ChunkMessages:
    """The messages of one chunk, in file order.

    Attributes
    ----------
    data : (size,) uint8, the decompressed records.
    offsets : (n,) start of each message record in `data`.
    headers : (n,) of dtype `MESSAGE_HEADER`.
    definitions : (opcode, content) of the schema and channel records in the chunk.
    is_complete : False if the records end in undecodable bytes.
    """

    data: NDArray[np.uint8]
    offsets: NDArray[np.int64]
    headers: NDArray[np.void]
    definitions: tuple[tuple[int, bytes], ...]
    is_complete: bool

    def between(self, start_ns: int, end_ns: int) -> ChunkMessages:
        """Return the messages with start_ns <= log time <= end_ns."""
        times = self.headers["log_time"]
        in_span = (times >= start_ns) & (times <= end_ns)
        return replace(self, offsets=self.offsets[in_span], headers=self.headers[in_span])

    def group_by_channel(self) -> Iterator[tuple[int, NDArray[np.intp]]]:
        """Yield each channel id with the indices of its messages."""
        channels = np.ascontiguousarray(self.headers["channel"])
        order = np.argsort(channels, kind="stable")
        ids, starts = np.unique(channels[order], return_index=True)
        yield from zip(ids.tolist(), np.split(order, starts[1:]), strict=False)

    def total_record_size(self, indices: NDArray[np.intp]) -> int:
        """Return the total size in bytes of the records with these indices."""
        return int(self.headers["length"][indices].sum())

    def payload(self, i: int) -> bytes:
        """Return the payload of message i."""
        start = int(self.offsets[i]) + MESSAGE_HEADER.itemsize
        return self.data[start : start + int(self.headers["length"][i]) - 22].tobytes()


def read_message_offsets(fd: int, location: ChunkLocation) -> NDArray[np.int64]:
    """Return the sorted record offsets that the message indexes after a chunk announce."""
    offsets, position = [], location.offset + location.length
    while location.compression is not None:
        header = pread(fd, _INDEX_HEADER.size, position)
        if len(header) < _INDEX_HEADER.size:
            break
        opcode, length, _, size = _INDEX_HEADER.unpack(header)
        if opcode != Opcode.MESSAGE_INDEX or length != size + 6 or size % 16 or size > location.expanded_size:
            break
        entries = pread(fd, size, position + _INDEX_HEADER.size)
        if len(entries) < size:
            break
        offsets.append(np.frombuffer(entries, "<i8")[1::2])
        position += _INDEX_HEADER.size + size
    return np.sort(np.concatenate(offsets)) if offsets else np.empty(0, np.int64)


def parse_messages(data: bytes, indexed_offsets: NDArray[np.int64] | None = None) -> ChunkMessages:
    """Locate the messages in a chunk's records, up to the first undecodable record.

    indexed_offsets: record offsets from the message indexes. They are used if the records at these offsets
    are contiguous from the first byte to the last, which is faster to verify than to parse.
    """
    if indexed_offsets is not None and len(indexed_offsets):
        headers = _headers_if_contiguous(data, indexed_offsets)
        if headers is not None:
            return ChunkMessages(np.frombuffer(data, np.uint8), indexed_offsets, headers, (), True)
    parts: list[NDArray[np.int64]] = []
    single: list[int] = []
    definitions: dict[tuple[int, bytes], bytes] = {}
    position, end, run, last = 0, len(data), 0, -1
    unpack = _RECORD_HEADER.unpack_from
    while position + _RECORD_HEADER.size <= end:
        opcode, length = unpack(data, position)
        after = position + _RECORD_HEADER.size + length
        if after > end or opcode == 0 or (opcode == Opcode.MESSAGE and length < 22):
            break
        if opcode == Opcode.MESSAGE:
            single.append(position)
            run = run + 1 if length == last else 0
            last = length
            if run == 8:
                stride = _RECORD_HEADER.size + length
                count = _count_equal_records(data, after, stride)
                parts += [np.array(single, np.int64), after + stride * np.arange(count)]
                single, run = [], 0
                after += count * stride
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            start = position + _RECORD_HEADER.size
            definitions.setdefault((opcode, data[start : start + 2]), data[start:after])
        position = after
    offsets = np.concatenate([*parts, np.array(single, np.int64)])
    defined = tuple((opcode, content) for (opcode, _), content in definitions.items())
    return ChunkMessages(
        np.frombuffer(data, np.uint8), offsets, _read_headers(data, offsets), defined, position == end
    )


def _headers_if_contiguous(data: bytes, offsets: NDArray[np.int64]) -> NDArray[np.void] | None:
    """Return the headers at these offsets if the records are contiguous and cover all data, else None."""
    if offsets[0] != 0 or offsets[-1] > len(data) - MESSAGE_HEADER.itemsize:
        return None
    headers = _read_headers(data, offsets)
    lengths = headers["length"].astype(np.int64)
    valid = (headers["opcode"] == Opcode.MESSAGE) & (lengths >= 22)
    valid &= offsets + _RECORD_HEADER.size + lengths == np.append(offsets[1:], len(data))
    return headers if valid.all() else None


def _read_headers(data: bytes, offsets: NDArray[np.int64]) -> NDArray[np.void]:
    if not len(offsets):
        return np.empty(0, MESSAGE_HEADER)
    header_at_byte: NDArray[np.void] = np.ndarray(
        (len(data) - MESSAGE_HEADER.itemsize + 1,), MESSAGE_HEADER, buffer=data, strides=(1,)
    )
    return header_at_byte[offsets]


def _count_equal_records(data: bytes, start: int, stride: int) -> int:
    """Count the consecutive message records of the same size from `start` on."""
    count, window = 0, 64
    while (n_records := min(window, (len(data) - start) // stride - count)) > 0:
        headers: NDArray[np.void] = np.ndarray(
            (n_records,), MESSAGE_HEADER, buffer=data, offset=start + count * stride, strides=(stride,)
        )
        same = (headers["opcode"] == 5) & (headers["length"] == stride - 9)
        if not bool(same.all()):
            return count + int(same.argmin())
        count, window = count + n_records, window * 4
    return count
