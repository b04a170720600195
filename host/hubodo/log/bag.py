"""Read rosbags of ROS 1 and ROS 2 as a source of CDR messages."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.chunk_reader import ChunkMessages, parse_messages
from hubodo.log.compressed_bag import Expander, StorageFiles, make_message_expander, read_compression_mode
from hubodo.log.logfile import Log, open_log
from hubodo.log.message_records import encode_message_record
from hubodo.log.number_file import detect_file_kind
from hubodo.log.source import FileInfo, Stream
from hubodo.log.sqlite_bag import READ_ERRORS, iterate_messages, read_database_facts

METADATA_FILE = "metadata.yaml"
_BATCH_BYTES = 4 << 20
BagRow = tuple[int, int, bytes]
"""Channel id, time of receipt in ns, message."""


def _no_op() -> None:
    """Do nothing; the default for bags without resources to close."""


class Bag:
    """A rosbag open for reading, its messages ordered by time of receipt. Built by `open_bag`."""

    def __init__(
        self,
        path: Path,
        facts: FileInfo,
        streams: Sequence[Stream],
        rows: Callable[[], Iterator[BagRow]],
        count: int,
        *,
        notes: Callable[[], Sequence[str]] = tuple,
        close: Callable[[], None] = _no_op,
        read_errors: tuple[type[Exception], ...] = (*READ_ERRORS, OSError),
    ) -> None:
        self.path, self._file_info = path, facts
        self.streams = {stream.id: stream for stream in streams}
        self.metadata_records: dict[str, dict[str, str]] = {}
        self.metadata: dict[str, str] = {}
        self.t_zero_ns: int | None = None
        self._iterate_rows, self._n_rows, self._n_read = rows, count, 0
        self._notes, self._warnings = notes, list[str]()
        self.close = close
        self._read_errors = read_errors

    @property
    def file_info(self) -> FileInfo:
        """Size, generation (ROS 1 or 2) and number of problems found while reading."""
        return replace(self._file_info, damaged=len(self.warnings()))

    @property
    def progress(self) -> float:
        """Fraction of the messages that `chunks()` has read."""
        return self._n_read / max(1, self._n_rows)

    def chunks(self) -> Iterator[ChunkMessages]:
        """Yield all messages, some megabytes at a time; messages after damage are lost and reported."""
        self._n_read, self._warnings = 0, []
        records, size = [], 0
        try:
            for channel, t_ns, payload in self._iterate_rows():
                records.append(encode_message_record(channel, self._n_read, t_ns, t_ns, payload))
                size += len(payload)
                self._n_read += 1
                if size >= _BATCH_BYTES:
                    yield parse_messages(b"".join(records))
                    records, size = [], 0
        except self._read_errors as error:
            self._warnings.append(
                f"{self.path}: {self._n_read} of {self._n_rows} messages are kept, the others cannot be read "
                f"({error})"
            )
        if records:
            yield parse_messages(b"".join(records))

    def warnings(self) -> tuple[str, ...]:
        """Return one line for each problem; complete once `chunks()` has finished."""
        return (*(f"{self.path}: {note}" for note in self._notes()), *self._warnings)


def open_bag(path: Path) -> Bag:
    """Open a ROS 1 bag, a rosbag2 folder or a .db3 file of one. Raises InputError where it cannot be read."""
    if not path.is_dir():
        return _open_sqlite(path, [path]) if detect_file_kind(path) == "sqlite" else _open_rosbag1(path)
    # Only files in the folder are read: paths in metadata.yaml may point outside of it.
    mode = read_compression_mode(path / METADATA_FILE)
    expand = make_message_expander(path) if mode == "message" else None
    storage = StorageFiles(path)
    try:
        if storage.databases:
            return _open_sqlite(path, storage.databases, expand, storage.close)
        if storage.logs:
            return _open_mcap_parts(path, storage.logs, expand, storage.close)
    except BaseException:
        storage.close()
        raise
    raise InputError(f"{path}: holds neither an .mcap nor a .db3 file; give the file that holds the messages")


def _unreadable_error(path: Path, error: Exception) -> InputError:
    return InputError(f"{path}: cannot be read as a rosbag ({error}); try ros2 bag reindex, or convert it")


def stored_size(path: Path) -> int:
    """Return the bytes of a file, or of the files of a folder."""
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def _number_streams(keys: Iterable[tuple[str, str, str]]) -> dict[tuple[str, str, str], Stream]:
    """Return a numbered stream for each distinct (topic, type, encoding)."""
    distinct = dict.fromkeys(keys)
    return {key: Stream(number, *key, {}) for number, key in enumerate(distinct, 1)}


def _open_sqlite(
    path: Path,
    files: Sequence[Path],
    expand: Expander | None = None,
    close: Callable[[], None] = _no_op,
) -> Bag:
    """Open SQLite files directly, because a killed recorder leaves no metadata.yaml."""
    try:
        facts = [read_database_facts(file) for file in files]
    except READ_ERRORS as error:
        raise _unreadable_error(path, error) from None
    streams = _number_streams(topic[1:] for fact in facts for topic in fact.topics)

    def rows() -> Iterator[BagRow]:
        for file, fact in zip(files, facts, strict=True):
            ids = {topic[0]: streams[topic[1:]].id for topic in fact.topics}
            for number, t_ns, payload in iterate_messages(file, fact):
                if number in ids:
                    yield ids[number], t_ns, payload if expand is None else expand(payload)

    count, unusable = sum(fact.n_messages for fact in facts), sum(fact.n_unusable for fact in facts)
    notes = [f"{unusable} rows are not of the types that rosbag2 writes; left out"] if unusable else []
    bag_facts = FileInfo(stored_size(path), "rosbag2", "ros2", True)
    return Bag(path, bag_facts, list(streams.values()), rows, count, notes=lambda: notes, close=close)


def _open_mcap_parts(
    path: Path, parts: Sequence[Path], expand: Expander | None, close: Callable[[], None]
) -> Bag:
    """Open a rosbag2 folder with several MCAP files and merge their messages by time."""
    logs = [open_log(part) for part in parts]
    for log in logs:
        for _ in log.chunks():  # some writers announce channels inside the chunks only
            pass
    streams = _number_streams((s.topic, s.schema, s.encoding) for log in logs for s in log.streams.values())

    def rows() -> Iterator[BagRow]:
        def of(log: Log) -> Iterator[BagRow]:
            ids = {s.id: streams[s.topic, s.schema, s.encoding].id for s in log.streams.values()}
            for message in log.messages():
                yield ids[message.channel], message.log_time, message.data

        for channel, t_ns, payload in heapq.merge(*map(of, logs), key=lambda row: row[1]):
            yield channel, t_ns, payload if expand is None else expand(payload)

    def close_all() -> None:
        for log in logs:
            log.close()
        close()

    facts = FileInfo(
        stored_size(path), logs[0].file_info.library, "ros2", all(log.file_info.complete for log in logs)
    )
    count = sum(log.messages_read for log in logs)
    return Bag(path, facts, list(streams.values()), rows, count, close=close_all)


def _open_rosbag1(path: Path) -> Bag:
    """Open a ROS 1 bag."""
    from hubodo.log import rosbag1

    try:
        bag = rosbag1.Rosbag1(path)
    except rosbag1.READ_ERRORS as error:
        raise _unreadable_error(path, error) from None
    streams = {
        topic: Stream(number, topic.topic, topic.type, "cdr" if topic.is_cdr else "ros1", {})
        for number, topic in enumerate(bag.topics, 1)
    }

    def rows() -> Iterator[BagRow]:
        for topic, t_ns, payload in bag.messages():
            yield streams[topic].id, t_ns, payload

    def notes() -> list[str]:
        return (
            [f"{bag.n_undecodable} messages do not match their type; left out"] if bag.n_undecodable else []
        )

    facts = FileInfo(stored_size(path), "rosbag", "ros1", True)
    stream_list = list(streams.values())
    return Bag(path, facts, stream_list, rows, bag.n_messages, notes=notes, read_errors=rosbag1.READ_ERRORS)
