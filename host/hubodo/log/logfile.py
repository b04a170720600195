"""Read an MCAP file: channels, metadata, messages in order, and a report of damage."""

from __future__ import annotations

import heapq
import os
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import LogError
from hubodo.log import topics
from hubodo.log.chunk_reader import (
    CHUNK_MEMORY_RATIO,
    ChunkLocation,
    ChunkMessages,
    DamagedChunk,
    parse_messages,
    read_chunk,
    read_message_offsets,
    read_truncated_chunk,
)
from hubodo.log.descriptor import open_read_only
from hubodo.log.input_limits import MemoryBudget, check_claim, max_expanded_bytes
from hubodo.log.message_records import MESSAGE_HEADER
from hubodo.log.scan import DamagedSpan, FileScan, scan_file
from hubodo.log.source import FileInfo, Stream

_MESSAGE_MEMORY_BYTES = 300  # per message of a chunk that is being merged: six Python numbers
MAX_T_ZERO_NS = 4_000_000_000 * 1_000_000_000
"""ns; the year 2096: a later t = 0 indicates a damaged metadata record."""


class LogMessage(NamedTuple):
    """One message of a log; times in ns."""

    topic: str
    log_time: int
    publish_time: int
    sequence: int
    channel: int
    data: bytes


class Log:
    """An MCAP file open for reading; a context manager. Built by `open_log`."""

    def __init__(self, scan: FileScan) -> None:
        self.scan = scan
        self._fd = open_read_only(scan.path)
        self.messages_read = 0
        """Messages read by `chunks()`."""
        self._position = 0
        self._streams: dict[int, Stream] = {}
        self._known_counts = (0, 0)
        """Numbers of channels and schemas from which `_streams` was built."""
        self._out_of_range: dict[int, int] = {}
        """Messages with times beyond the range of int64, by the offset of their chunk."""

    @property
    def path(self) -> Path:
        """The path of the file."""
        return self.scan.path

    @property
    def file_info(self) -> FileInfo:
        """Size, writer, profile, completeness and damage of the file."""
        scan = self.scan
        files = {name: len(data) for name, data in self.attachments.items()}
        return FileInfo(scan.size, scan.library, scan.profile, scan.complete, files, self.damage_count)

    @property
    def streams(self) -> dict[int, Stream]:
        """The known channels by id; those stored inside chunks are known after `chunks()` has finished."""
        schemas = self.scan.schemas
        if (len(self.scan.channels), len(schemas)) == self._known_counts:
            return self._streams
        self._known_counts = len(self.scan.channels), len(schemas)
        for id, channel in self.scan.channels.items():
            known = self._streams.get(id)
            if known is None or (channel.schema_id in schemas and not known.schema):
                schema = schemas[channel.schema_id].name if channel.schema_id in schemas else ""
                metadata = dict(channel.metadata)
                self._streams[id] = Stream(id, channel.topic, schema, channel.message_encoding, metadata)
        return self._streams

    @property
    def metadata_records(self) -> dict[str, dict[str, str]]:
        """Metadata records by name."""
        return {record.name: dict(record.metadata) for record in self.scan.metadata}

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name."""
        return {file.name: bytes(file.data) for file in self.scan.attachments}

    @property
    def metadata(self) -> dict[str, str]:
        """The metadata record `hubodo`, and the others with their name and a dot before each key."""
        flat: dict[str, str] = {}
        for name, values in self.metadata_records.items():
            prefix = "" if name == topics.METADATA_RECORD else name + "."
            flat.update({prefix + key: value for key, value in values.items()})
        return flat

    @property
    def t_zero_ns(self) -> int | None:
        """Host time of t = 0 in ns; None if the log does not state a plausible one."""
        text = self.metadata.get(topics.T_ZERO_KEY, "")
        stated = int(text) if text.isascii() and text.isdigit() and len(text) < 20 else -1
        return stated if 0 <= stated < MAX_T_ZERO_NS else None

    @property
    def progress(self) -> float:
        """Fraction of the file that `chunks()` has read."""
        return self._position / max(1, self.scan.size)

    def chunks(self, at_most: int | None = None) -> Iterator[ChunkMessages]:
        """Yield all messages, chunk by chunk in file order; damage is recorded and skipped.

        at_most: number of chunks to read, at equal steps from the first one.
        """
        self.messages_read = 0
        chosen = range(len(self.scan.chunks))
        if at_most is not None and at_most < len(chosen):
            chosen = range(0, len(chosen), -(-len(chosen) // at_most))
        for location in (self.scan.chunks[number] for number in chosen):
            self._position = location.offset + location.length
            messages = self._read_chunk(location)
            if messages is not None:
                self.messages_read += len(messages.offsets)
                yield messages
        if self.scan.truncated_chunk is not None:
            messages = self._read_truncated_chunk(self.scan.truncated_chunk)
            self.messages_read += len(messages.offsets)
            yield messages

    def _read_chunk(self, location: ChunkLocation) -> ChunkMessages | None:
        if location.offset in self.scan.oversized_chunks:
            self.scan.mark_damaged(
                location, f"chunk claims {location.expanded_size} bytes, more than such a file can hold"
            )
            return None
        check_claim(CHUNK_MEMORY_RATIO * location.expanded_size, self.path, "a chunk")
        try:
            messages = parse_messages(
                read_chunk(self._fd, location), read_message_offsets(self._fd, location)
            )
        except DamagedChunk as error:
            self.scan.mark_damaged(location, f"chunk {error}")
            return None
        self.scan.add_definitions(messages.definitions)
        if not messages.is_complete:
            self.scan.mark_damaged(location, "chunk ends in undecodable bytes")
        possible = (messages.headers["log_time"] >= 0) & (messages.headers["publish_time"] >= 0)
        if not possible.all():
            self._out_of_range[location.offset] = int(np.count_nonzero(~possible))
            messages = replace(
                messages, offsets=messages.offsets[possible], headers=messages.headers[possible]
            )
        return messages

    def _read_truncated_chunk(self, location: ChunkLocation) -> ChunkMessages:
        check_claim(
            min(CHUNK_MEMORY_RATIO * location.expanded_size, max_expanded_bytes(location.data_size)),
            self.path,
            "its last chunk",
        )
        # A truncated chunk has no valid checksum; the time span in its header is some protection.
        messages = parse_messages(read_truncated_chunk(self._fd, location)).between(
            location.start_ns, location.end_ns
        )
        self.scan.add_definitions(messages.definitions)
        return messages

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        end: int | None = None,
    ) -> Iterator[LogMessage]:
        """Yield messages by log time, start <= log_time < end (ns); equal times keep the order of the file.

        Only chunks that overlap in time are in memory. Raises InputError if they exceed the memory limit.
        """
        budget = MemoryBudget(self.path)
        unread = [
            (number, location)
            for number, location in enumerate(self.scan.chunks)
            if (start is None or location.end_ns >= start) and (end is None or location.start_ns < end)
        ]
        unread.sort(key=lambda numbered: numbered[1].start_ns, reverse=True)
        cut = self.scan.truncated_chunk
        cursors: list[tuple[int, int, Iterator[LogMessage], LogMessage]] = []
        while unread or cursors or cut is not None:
            while unread and (not cursors or unread[-1][1].start_ns <= cursors[0][0]):
                number, place = unread.pop()
                self._push_cursor(cursors, number, self._messages_of_chunk(place, topics, start, end, budget))
            if cut is not None and not unread:
                messages, cut = self._read_truncated_chunk(cut), None
                self._push_cursor(
                    cursors,
                    len(self.scan.chunks),
                    self._select_messages(messages, topics, start, end, budget),
                )
            if cursors:
                _, number, remaining, message = cursors[0]
                yield message
                following = next(remaining, None)
                if following is None:
                    heapq.heappop(cursors)
                else:
                    heapq.heapreplace(cursors, (following.log_time, number, remaining, following))

    @staticmethod
    def _push_cursor(
        cursors: list[tuple[int, int, Iterator[LogMessage], LogMessage]],
        number: int,
        messages: Iterator[LogMessage],
    ) -> None:
        first = next(messages, None)
        if first is not None:
            heapq.heappush(cursors, (first.log_time, number, messages, first))

    def _messages_of_chunk(
        self,
        location: ChunkLocation,
        topics: Collection[str] | None,
        start: int | None,
        end: int | None,
        budget: MemoryBudget,
    ) -> Iterator[LogMessage]:
        messages = self._read_chunk(location)
        if messages is not None:
            yield from self._select_messages(messages, topics, start, end, budget)

    def _select_messages(
        self,
        messages: ChunkMessages,
        topics: Collection[str] | None,
        start: int | None,
        end: int | None,
        budget: MemoryBudget,
    ) -> Iterator[LogMessage]:
        streams = self.streams
        wanted = [id for id, stream in streams.items() if topics is None or stream.topic in topics]
        times: NDArray[np.int64] = messages.headers["log_time"]
        keep = np.isin(messages.headers["channel"], wanted)
        if start is not None:
            keep &= times >= start
        if end is not None:
            keep &= times < end
        selected = np.flatnonzero(keep)
        selected = selected[np.argsort(times[selected], kind="stable")]
        cost = 2 * messages.data.nbytes + _MESSAGE_MEMORY_BYTES * len(selected)
        budget.claim(cost, "reading chunks that overlap in time")
        headers, data = messages.headers[selected], messages.data.tobytes()
        starts = messages.offsets[selected] + MESSAGE_HEADER.itemsize
        ends = starts + headers["length"].astype(np.int64) - 22
        columns = (
            headers["channel"],
            headers["log_time"],
            headers["publish_time"],
            headers["sequence"],
            starts,
            ends,
        )
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for channel, log_time, publish_time, sequence, start_byte, end_byte in rows:
            yield LogMessage(
                streams[channel].topic, log_time, publish_time, sequence, channel, data[start_byte:end_byte]
            )
        budget.release(cost)

    @property
    def _has_unlocated_damage(self) -> bool:
        """True if the data section fails its checksum but no damaged part was found."""
        return "data" in self.scan.checksum_failures and not self.scan.damage

    @property
    def damage_count(self) -> int:
        """Number of damaged parts; complete once `chunks()` has finished."""
        return len(self.scan.damage) + self._has_unlocated_damage + ("summary" in self.scan.checksum_failures)

    def warnings(self) -> tuple[str, ...]:
        """Return one line for each problem of the file; complete once `chunks()` has finished."""
        scan, lines = self.scan, []
        for damage in sorted(scan.damage, key=lambda damage: damage.offset):
            if damage.offset + damage.length >= scan.size and not scan.complete:
                continue
            lines.append(f"{scan.path}: {self._describe_span(damage)}: {damage.reason}; left out")
        if not scan.complete:
            lost = sum(d.length for d in scan.damage if d.offset + d.length >= scan.size)
            lines.append(
                f"{scan.path}: was not closed: {self.messages_read} messages are kept, {lost} bytes at the "
                "end are lost; hubodo recover writes a complete log"
            )
        if self._has_unlocated_damage:
            lines.append(
                f"{scan.path}: {scan.checksum_failures['data']}, but every chunk is intact: the "
                "records between the chunks are damaged; metadata (t = 0) and topic names may be wrong"
            )
        if self._out_of_range:
            count = sum(self._out_of_range.values())
            lines.append(f"{scan.path}: {count} messages have times beyond the year 2262; left out")
        if "summary" in scan.checksum_failures:
            lines.append(f"{scan.path}: {scan.checksum_failures['summary']}; it is not used")
        return tuple(lines)

    def _describe_span(self, damage: DamagedSpan) -> str:
        text = f"bytes {damage.offset} to {damage.offset + damage.length}"
        if damage.start_ns is not None and damage.end_ns is not None:
            zero = self.t_zero_ns or 0
            text += f" (t = {(damage.start_ns - zero) / 1e9:.3f} s to {(damage.end_ns - zero) / 1e9:.3f} s)"
        return text

    def close(self) -> None:
        """Close the file. Idempotent."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_log(path: Path) -> Log:
    """Open an MCAP file, even truncated or damaged. Raises LogError if it is missing, empty or not MCAP."""
    path = Path(path)
    if path.is_dir():
        raise LogError(f"{path}: is a folder, not a log; import a CSV folder with hubodo import")
    return Log(scan_file(path))
