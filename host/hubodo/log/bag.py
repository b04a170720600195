"""Rosbags of either generation as a source of messages: every message as the CDR that MCAP has, unread."""

from __future__ import annotations

import heapq
import re
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log import ros2
from hubodo.log.chunk_body import Messages, walk
from hubodo.log.logfile import Log, open_log
from hubodo.log.message_records import message_record
from hubodo.log.number_file import kind_of
from hubodo.log.source import Facts, Stream

_HEADER = "std_msgs/msg/Header"
METADATA_FILE = "metadata.yaml"
_UNDERSTOOD = ros2.STAMPED | {ros2.COLUMNS, ros2.STRING, ros2.BYTES}
_PORTION = 4 << 20
Row = tuple[int, int, bytes]
"""Channel, time in ns, message."""


class Bag:
    """A rosbag opened for reading; build it with `open_bag`. Its messages come by the time of receipt."""

    def __init__(
        self,
        path: Path,
        facts: Facts,
        streams: Sequence[Stream],
        rows: Callable[[], Iterator[Row]],
        count: int,
    ) -> None:
        self.path, self._facts = path, facts
        self.streams = {stream.id: stream for stream in streams}
        self.records: dict[str, dict[str, str]] = {}
        self.metadata: dict[str, str] = {}
        self.t_zero_ns: int | None = None
        self._rows, self._count, self._read = rows, count, 0
        self._warnings: list[str] = []

    @property
    def facts(self) -> Facts:
        """Size, generation, and whether all of it could be read."""
        return replace(self._facts, damaged=len(self._warnings))

    @property
    def progress(self) -> float:
        """Fraction of the messages that `chunks()` has gone through."""
        return self._read / max(1, self._count)

    def chunks(self) -> Iterator[Messages]:
        """All messages, some megabytes at a time; what comes behind damage is lost and told."""
        self._read, self._warnings = 0, []
        waiting, size = [], 0
        try:
            for channel, t_ns, payload in self._rows():
                waiting.append(message_record(channel, self._read, t_ns, t_ns, payload))
                size += len(payload)
                self._read += 1
                if size >= _PORTION:
                    yield walk(b"".join(waiting))
                    waiting, size = [], 0
        except _damage() as error:
            self._warnings.append(
                f"{self.path}: {self._read} of {self._count} messages are kept, the others cannot be read "
                f"({error})"
            )
        if waiting:
            yield walk(b"".join(waiting))

    def warnings(self) -> tuple[str, ...]:
        """One line for what could not be read; complete once its chunks were read."""
        return tuple(self._warnings)


def open_bag(path: Path) -> Bag:
    """A ROS 1 bag, a rosbag2 folder or a .db3 file of one. Raises InputError where it cannot be read."""
    files = sorted(path.glob("*.db3")) if path.is_dir() else [path]
    parts = sorted(path.glob("*.mcap")) if path.is_dir() else []
    if _compressed(path):
        return _rosbag(path)
    if files and kind_of(files[0]) == "sqlite":
        return _sqlite(path, files)
    return _mcap_parts(path, parts) if parts else _rosbag(path)


def _compressed(path: Path) -> bool:
    """Whether a rosbag2 folder says that its recorder, not its storage, compressed it."""
    try:
        text = (path / METADATA_FILE).read_text("utf-8", "replace")
    except OSError:
        return False
    return re.search(r"compression_mode: *['\"]?(file|message)", text, re.IGNORECASE) is not None


def _damage() -> tuple[type[Exception], ...]:
    from rosbags.highlevel import AnyReaderError
    from rosbags.rosbag1 import ReaderError as Damaged1
    from rosbags.rosbag2 import ReaderError as Damaged2
    from rosbags.serde import SerdeError

    return (AnyReaderError, Damaged1, Damaged2, SerdeError, sqlite3.Error, OSError, KeyError, ValueError)


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError(f"{path}: cannot be read as a rosbag ({error}); try ros2 bag reindex, or convert it")


def _size(path: Path) -> int:
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def _sqlite(path: Path, files: list[Path]) -> Bag:
    """Topics and messages of sqlite files; a killed recorder never writes metadata.yaml."""
    streams: dict[tuple[str, str, str], Stream] = {}
    count = 0
    numbers: list[dict[int, int]] = []
    try:
        for file in files:
            with closing(_connect(file)) as base:
                numbers.append({})
                for number, topic, kind, form in base.execute(
                    "SELECT id, name, type, serialization_format FROM topics"
                ):
                    key = (topic, kind, form)
                    streams.setdefault(key, Stream(len(streams) + 1, topic, kind, form, {}))
                    numbers[-1][number] = streams[key].id
                count += base.execute("SELECT COUNT(*) FROM messages").fetchone()[0]
    except sqlite3.Error as error:
        raise _unreadable(path, error) from None

    def rows() -> Iterator[Row]:
        for file, ids in zip(files, numbers, strict=True):
            with closing(_connect(file)) as base:
                for number, t_ns, payload in base.execute(
                    "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp"
                ):
                    if number in ids and t_ns >= 0:
                        yield ids[number], t_ns, payload

    return Bag(path, Facts(_size(path), "rosbag2", "ros2", True), list(streams.values()), rows, count)


def _connect(file: Path) -> sqlite3.Connection:
    # A killed recorder leaves messages in a journal beside; without one, nothing needs writing there.
    journal = file.with_name(file.name + "-wal").exists()
    how = "mode=ro" if journal else "mode=ro&immutable=1"
    return sqlite3.connect(f"{file.absolute().as_uri()}?{how}", uri=True)


def _mcap_parts(path: Path, parts: list[Path]) -> Bag:
    """A rosbag2 folder whose recording went into several MCAP files, by time."""
    streams: dict[tuple[str, str, str], Stream] = {}
    logs = [open_log(part) for part in parts]
    for log in logs:
        for _ in log.chunks():  # some writers announce channels inside the chunks only
            pass
        for stream in log.streams.values():
            key = (stream.topic, stream.schema, stream.encoding)
            streams.setdefault(key, Stream(len(streams) + 1, *key, stream.metadata))
    kept = sum(log.kept for log in logs)

    def rows() -> Iterator[Row]:
        def of(log: Log) -> Iterator[Row]:
            ids = {s.id: streams[s.topic, s.schema, s.encoding].id for s in log.streams.values()}
            for message in log.messages():
                yield ids[message.channel], message.log_time, message.data

        yield from heapq.merge(*map(of, logs), key=lambda row: row[1])

    facts = Facts(_size(path), logs[0].facts.library, "ros2", all(log.facts.complete for log in logs))
    return Bag(path, facts, list(streams.values()), rows, kept)


def _rosbag(path: Path) -> Bag:
    """What the package rosbags reads: bags of ROS 1, and compressed ones of ROS 2."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path]) as reader:
            kinds = {(it.topic, it.msgtype) for it in reader.connections}
            count, is_2 = reader.message_count, reader.is2
    except _damage() as error:
        raise _unreadable(path, error) from None
    streams = {
        (topic, kind): Stream(n, topic, kind, "cdr" if is_2 or kind in _UNDERSTOOD else "ros1", {})
        for n, (topic, kind) in enumerate(sorted(kinds), 1)
    }

    def rows() -> Iterator[Row]:
        with AnyReader([path]) as reader:
            types = dict(reader.typestore.fielddefs)
            # A header of ROS 1 has a number more; the package drops it on the way to a type without.
            types[_HEADER] = get_typestore(Stores.ROS2_HUMBLE).fielddefs[_HEADER]
            store = get_typestore(Stores.EMPTY)
            store.register(types)
            for connection, t_ns, raw in reader.messages():
                stream = streams[connection.topic, connection.msgtype]
                as_it_is = is_2 or stream.encoding == "ros1"
                data = raw if as_it_is else store.ros1_to_cdr(raw, connection.msgtype)
                yield stream.id, t_ns, bytes(data)

    facts = Facts(_size(path), "rosbag2" if is_2 else "rosbag", "ros2" if is_2 else "ros1", True)
    return Bag(path, facts, list(streams.values()), rows, count)
