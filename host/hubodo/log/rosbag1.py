"""A ROS 1 bag as CDR messages: the package rosbags reads its records, here within bounds."""

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
from hubodo.log.input_limits import MemoryBudget, check_claim, file_budget, limit_bytes, open_regular, room_of

READ_ERRORS = (
    *(ReaderError, SerdeError, OSError, EOFError, ValueError, TypeError, AttributeError, LookupError),
    *(AssertionError, ArithmeticError, RuntimeError, struct.error),
)
"""What the package raises for records that make no sense."""
CDR_TYPES = ros2.STAMPED | {ros2.COLUMNS, ros2.STRING, ros2.BYTES}
"""Types whose messages are converted; those of other topics stay in the encoding of ROS 1."""
_HEADER = "std_msgs/msg/Header"
_INDEX_ENTRY_RATIO = 16  # bytes of memory per byte of a bag's index
_CACHED_CHUNKS = 4  # of which messages overlap in time
_TRAFFIC_RATIO, _LEAST_TRAFFIC = 1024, 1 << 30  # bytes read from chunks, by which alternating chunks end
Expander = Callable[[bytes, int], bytes]
"""Expands compressed data up to a number of bytes."""


def _uncompressed(data: bytes, room: int) -> bytes:
    return data[:room]


def _expand_bz2(data: bytes, room: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(data, room)


def _expand_lz4(data: bytes, room: int) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, room))


_EXPANDERS: Mapping[Any, Expander] = {bz2.decompress: _expand_bz2, lz4.frame.decompress: _expand_lz4}
"""By the function that the package would use."""


@dataclass(frozen=True)
class Rosbag1Topic:
    """A connection of a bag. is_cdr: whether its messages can be converted to the type of ROS 2."""

    topic: str
    type: str
    is_cdr: bool


class Rosbag1:
    """A ROS 1 bag. Raises one of READ_ERRORS where it cannot be read, InputError beyond the memory limit."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.n_unfit = 0
        """Messages so far that do not fit their type."""
        with _BoundedReader(path) as reader:
            self.topics = tuple(dict.fromkeys(map(self._topic, reader.connections)))
            self.n_messages = reader.message_count

    def messages(self) -> Iterator[tuple[Rosbag1Topic, int, bytes]]:
        """Yield (topic, time in ns, message), by time."""
        self.n_unfit = 0
        with _BoundedReader(self.path) as reader:
            topics = {connection.id: self._topic(connection) for connection in reader.connections}
            for connection, t_ns, raw in reader.messages():
                topic = topics[connection.id]
                if not topic.is_cdr:
                    yield topic, t_ns, bytes(raw)
                    continue
                try:
                    data = bytes(_converter().ros1_to_cdr(raw, topic.type))
                except (SerdeError, ValueError, LookupError, AssertionError, struct.error):
                    self.n_unfit += 1
                    continue
                yield topic, t_ns, data

    @staticmethod
    def _topic(connection: Connection) -> Rosbag1Topic:
        """Compare the definition in the bag, by its checksum, with the known one; no other is used."""
        is_cdr = connection.msgtype in CDR_TYPES and connection.digest in ("*", _digest(connection.msgtype))
        return Rosbag1Topic(connection.topic, connection.msgtype, is_cdr)


class _BoundedFile(io.BufferedReader):
    """A file that is never asked for more bytes than it has left, whatever length a record claims."""

    def __init__(self, path: Path) -> None:
        super().__init__(open_regular(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self._size - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


class _BoundedPath:
    """The path of a bag as the package's reader uses it."""

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
    """The package's reader, which decompresses and indexes no more than a bag of this size can hold."""

    def __init__(self, path: Path) -> None:
        super().__init__(cast(Any, _BoundedPath(path)))
        self.file = path
        size = path.stat().st_size
        self._index_budget = MemoryBudget(path)
        self._index_left = size
        self._room = file_budget(path, room_of(size))
        self._traffic = file_budget(path, _TRAFFIC_RATIO * size + _LEAST_TRAFFIC)
        self._expanded = functools.lru_cache(_CACHED_CHUNKS)(self._expand)

    def read_index_data(self, pos: int, indexes: dict[int, list[Any]]) -> None:
        assert self.bio
        start = self.bio.tell()
        super().read_index_data(pos, indexes)
        n_bytes = self.bio.tell() - start
        self._index_left -= n_bytes
        if self._index_left < 0:
            raise ReaderError("its index is longer than the file")
        self._index_budget.claim(_INDEX_ENTRY_RATIO * n_bytes, "its index")

    def read_chunk(self) -> Any:
        chunk = super().read_chunk()
        expand = _EXPANDERS.get(chunk.decompressor, _uncompressed)
        return chunk._replace(decompressor=functools.partial(self._chunk, expand))

    def _chunk(self, expand: Expander, data: bytes) -> bytes:
        self._traffic.claim(len(data), "the reading of its alternating chunks")
        return self._expanded(expand, data)

    def _expand(self, expand: Expander, data: bytes) -> bytes:
        room = min(self._room.limit - self._room.claimed, limit_bytes())
        expanded = expand(data, room + 1)
        self._room.claim(len(expanded), "the sum of its chunks")
        check_claim(len(expanded), self.file, "a chunk")
        return expanded


@functools.cache
def _digest(kind: str) -> str:
    return get_typestore(Stores.ROS1_NOETIC).generate_msgdef(kind)[1]


@functools.cache
def _converter() -> Typestore:
    """Return the types of ROS 1 with the header of ROS 2; the package drops the counter that it lacks."""
    types = dict(get_typestore(Stores.ROS1_NOETIC).fielddefs)
    types[_HEADER] = get_typestore(Stores.ROS2_HUMBLE).fielddefs[_HEADER]
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store
