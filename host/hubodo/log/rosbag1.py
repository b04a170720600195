"""Read a ROS 1 bag as CDR messages, with the package rosbags restricted to bounded memory."""

from __future__ import annotations

import bz2
import functools
import io
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import lz4.frame
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader, ReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from hubodo.log import ros2
from hubodo.log.input_limits import (
    MemoryBudget,
    check_claim,
    file_budget,
    limit_bytes,
    max_expanded_bytes,
    open_regular,
)

READ_ERRORS = (
    *(ReaderError, SerdeError, OSError, EOFError, ValueError, TypeError, AttributeError, LookupError),
    *(AssertionError, ArithmeticError, RuntimeError, struct.error),
)
"""Errors that the package raises for damaged records."""
CDR_TYPES = ros2.STAMPED_TYPES | {ros2.FLOAT64_ARRAY, ros2.STRING, ros2.UINT8_ARRAY}
"""Types whose messages are converted to CDR; others keep the encoding of ROS 1."""
_HEADER_TYPE = "std_msgs/msg/Header"
_INDEX_MEMORY_RATIO = 16  # bytes of memory per byte of a bag's index
_MAX_CACHED_CHUNKS = 4  # number of chunks that may overlap in time without being expanded again
_READ_RATIO, _MIN_READ_BYTES = 1024, 1 << 30  # bytes expanded per byte of the bag, and at least
Expander = Callable[[bytes, int], bytes]
"""A function that expands compressed data up to a number of bytes."""


def _copy_uncompressed(data: bytes, room: int) -> bytes:
    return data[:room]


def _expand_bz2(data: bytes, room: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, room)


def _expand_lz4(data: bytes, room: int) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, room))


_EXPANDERS: Mapping[Any, Expander] = {bz2.decompress: _expand_bz2, lz4.frame.decompress: _expand_lz4}
"""Bounded expander for each decompressor of the package."""


@dataclass(frozen=True)
class Rosbag1Topic:
    """A topic of a bag. is_cdr: True if its messages can be converted to the ROS 2 type."""

    topic: str
    type: str
    is_cdr: bool


class Rosbag1:
    """A ROS 1 bag. Raises one of READ_ERRORS if it is damaged, InputError beyond the memory limit."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.n_undecodable = 0
        """Messages read that do not match their type."""
        with _BoundedReader(path) as reader:
            self.topics = tuple(dict.fromkeys(map(self._describe_topic, reader.connections)))
            self.n_messages = reader.message_count

    def messages(self) -> Iterator[tuple[Rosbag1Topic, int, bytes]]:
        """Yield (topic, time of receipt in ns, message) by time."""
        self.n_undecodable = 0
        with _BoundedReader(self.path) as reader:
            topics = {connection.id: self._describe_topic(connection) for connection in reader.connections}
            for connection, t_ns, raw in reader.messages():
                topic = topics[connection.id]
                if not topic.is_cdr:
                    yield topic, t_ns, bytes(raw)
                    continue
                try:
                    data = bytes(_converter().ros1_to_cdr(raw, topic.type))
                except (SerdeError, ValueError, LookupError, AssertionError, struct.error):
                    self.n_undecodable += 1
                    continue
                yield topic, t_ns, data

    @staticmethod
    def _describe_topic(connection: Connection) -> Rosbag1Topic:
        """Return the topic of a connection; only messages with the known definition (by checksum) are CDR."""
        is_cdr = connection.msgtype in CDR_TYPES and connection.digest in (
            "*",
            _definition_digest(connection.msgtype),
        )
        return Rosbag1Topic(connection.topic, connection.msgtype, is_cdr)


class _BoundedFile(io.BufferedReader):
    """A file whose reads are limited to its remaining bytes, whatever length a record claims."""

    def __init__(self, path: Path) -> None:
        super().__init__(open_regular(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self._size - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


class _BoundedPath:
    """The part of `Path` that the package's reader uses, opening a bounded file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __str__(self) -> str:
        return str(self._path)

    def exists(self) -> bool:
        return self._path.exists()

    def open(self, mode: str) -> _BoundedFile:
        del mode
        return _BoundedFile(self._path)


class _BoundedReader(Reader):
    """The package's reader with budgets for expanded data, index and repeated reads."""

    def __init__(self, path: Path) -> None:
        super().__init__(cast(Any, _BoundedPath(path)))
        self.file = path
        size = path.stat().st_size
        self._index_budget = MemoryBudget(path)
        self._index_left = size
        self._expansion_budget = file_budget(path, max_expanded_bytes(size))
        self._read_budget = file_budget(path, _READ_RATIO * size + _MIN_READ_BYTES)
        self._expand_cached = functools.lru_cache(_MAX_CACHED_CHUNKS)(self._expand)

    def read_index_data(self, pos: int, indexes: dict[int, list[Any]]) -> None:
        assert self.bio
        start = self.bio.tell()
        super().read_index_data(pos, indexes)
        n_bytes = self.bio.tell() - start
        self._index_left -= n_bytes
        if self._index_left < 0:
            raise ReaderError("its index is longer than the file")
        self._index_budget.claim(_INDEX_MEMORY_RATIO * n_bytes, "its index")

    def read_chunk(self) -> Any:
        chunk = super().read_chunk()
        expand = _EXPANDERS.get(chunk.decompressor, _copy_uncompressed)
        return chunk._replace(decompressor=functools.partial(self._expand_chunk, expand))

    def _expand_chunk(self, expand: Expander, data: bytes) -> bytes:
        self._read_budget.claim(len(data), "the reading of its alternating chunks")
        return self._expand_cached(expand, data)

    def _expand(self, expand: Expander, data: bytes) -> bytes:
        room = min(self._expansion_budget.limit - self._expansion_budget.claimed, limit_bytes())
        expanded = expand(data, room + 1)
        self._expansion_budget.claim(len(expanded), "the sum of its chunks")
        check_claim(len(expanded), self.file, "a chunk")
        return expanded


@functools.cache
def _definition_digest(kind: str) -> str:
    return get_typestore(Stores.ROS1_NOETIC).generate_msgdef(kind)[1]


@functools.cache
def _converter() -> Typestore:
    """Return the types of ROS 1 with the header of ROS 2, which has no sequence counter."""
    types = dict(get_typestore(Stores.ROS1_NOETIC).fielddefs)
    types[_HEADER_TYPE] = get_typestore(Stores.ROS2_HUMBLE).fielddefs[_HEADER_TYPE]
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store
