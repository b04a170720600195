"""An MCAP file opened for reading: what is in it, its messages in order, and what is wrong with it."""

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
    MEMORY_PER_BYTE,
    ChunkPlace,
    DamagedChunk,
    Messages,
    announced,
    load,
    load_cut,
    walk,
)
from hubodo.log.descriptor import open_to_read
from hubodo.log.input_limits import MemoryBudget, check_claim, room_of
from hubodo.log.message_records import MESSAGE_HEADER
from hubodo.log.scan import DamagedSpan, Scan, scan
from hubodo.log.source import FileInfo, Stream

_MESSAGE_MEMORY_BYTES = 300  # bytes per message of a chunk that waits for its turn: six numbers of Python
MAX_T_ZERO_NS = 4_000_000_000 * 1_000_000_000
"""ns; the year 2096: what is beyond is no time of a recording but a damaged metadata record."""


class LogMessage(NamedTuple):
    """One message as it stands in the log; times in ns."""

    topic: str
    log_time: int
    publish_time: int
    sequence: int
    channel: int
    data: bytes


class Log:
    """A log open for reading; a context manager. Build it with `open_log`."""

    def __init__(self, found: Scan) -> None:
        self.scan = found
        self._fd = open_to_read(found.path)
        self.messages_read = 0
        """Messages met so far by `chunks()`."""
        self._position = 0
        self._streams: dict[int, Stream] = {}
        self._known_counts = (0, 0)
        """Channels and schemas that `_streams` was made of."""
        self._out_of_range: dict[int, int] = {}
        """Messages beyond the times of the format, by the offset of their chunk."""

    @property
    def path(self) -> Path:
        """The file."""
        return self.scan.path

    @property
    def file_info(self) -> FileInfo:
        """Size, writer, profile, whether it was closed, what is damaged."""
        found = self.scan
        files = {name: len(data) for name, data in self.attachments.items()}
        return FileInfo(found.size, found.library, found.profile, found.complete, files, self.damage_count)

    @property
    def streams(self) -> dict[int, Stream]:
        """The channels known so far, by id; where they stand inside chunks, complete once `chunks()` ran."""
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
        """Files kept in the log, by name."""
        return {file.name: bytes(file.data) for file in self.scan.attachments}

    @property
    def metadata(self) -> dict[str, str]:
        """The record `hubodo`, and the others with their name and a dot before each key."""
        flat: dict[str, str] = {}
        for name, values in self.metadata_records.items():
            prefix = "" if name == topics.METADATA_RECORD else name + "."
            flat.update({prefix + key: value for key, value in values.items()})
        return flat

    @property
    def t_zero_ns(self) -> int | None:
        """Host time of t = 0 as the log states it; None where it does not, or not a time that can be."""
        text = self.metadata.get(topics.T_ZERO_KEY, "")
        stated = int(text) if text.isascii() and text.isdigit() and len(text) < 20 else -1
        return stated if 0 <= stated < MAX_T_ZERO_NS else None

    @property
    def progress(self) -> float:
        """Fraction of the file that `chunks()` has gone through."""
        return self._position / max(1, self.scan.size)

    def chunks(self) -> Iterator[Messages]:
        """All messages, a chunk at a time in file order; damage is noted and passed over."""
        self.messages_read = 0
        for place in self.scan.chunks:
            self._position = place.offset + place.length
            messages = self._read_chunk(place)
            if messages is not None:
                self.messages_read += len(messages.places)
                yield messages
        if self.scan.cut is not None:
            messages = self._read_truncated_chunk(self.scan.cut)
            self.messages_read += len(messages.places)
            yield messages

    def _read_chunk(self, place: ChunkPlace) -> Messages | None:
        if place.offset in self.scan.unbelievable:
            self.scan.note(place, f"chunk claims {place.size} bytes, more than such a file can hold")
            return None
        check_claim(MEMORY_PER_BYTE * place.size, self.path, "a chunk")
        try:
            messages = walk(load(self._fd, place), announced(self._fd, place))
        except DamagedChunk as error:
            self.scan.note(place, f"chunk {error}")
            return None
        self.scan.learn(messages.definitions)
        if not messages.whole:
            self.scan.note(place, "chunk ends in nonsense")
        possible = (messages.heads["log_time"] >= 0) & (messages.heads["publish_time"] >= 0)
        if not possible.all():
            self._out_of_range[place.offset] = int(np.count_nonzero(~possible))
            messages = replace(messages, places=messages.places[possible], heads=messages.heads[possible])
        return messages

    def _read_truncated_chunk(self, place: ChunkPlace) -> Messages:
        check_claim(min(MEMORY_PER_BYTE * place.size, room_of(place.data_size)), self.path, "its last chunk")
        # No checksum vouches for a part; the times that the chunk's head announces are some guard.
        messages = walk(load_cut(self._fd, place)).between(place.start_ns, place.end_ns)
        self.scan.learn(messages.definitions)
        return messages

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        end: int | None = None,
    ) -> Iterator[LogMessage]:
        """Messages by log time, start <= log_time < end (ns), those of one time in the order of the file.

        Holds only the chunks that overlap in time. Raises InputError where they exceed the memory limit.
        """
        budget = MemoryBudget(self.path)
        waiting = [
            (number, place)
            for number, place in enumerate(self.scan.chunks)
            if (start is None or place.end_ns >= start) and (end is None or place.start_ns < end)
        ]
        waiting.sort(key=lambda numbered: numbered[1].start_ns, reverse=True)
        cut = self.scan.cut
        cursors: list[tuple[int, int, Iterator[LogMessage], LogMessage]] = []
        while waiting or cursors or cut is not None:
            while waiting and (not cursors or waiting[-1][1].start_ns <= cursors[0][0]):
                number, place = waiting.pop()
                self._push_cursor(cursors, number, self._messages_of_chunk(place, topics, start, end, budget))
            if cut is not None and not waiting:
                messages, cut = self._read_truncated_chunk(cut), None
                self._push_cursor(
                    cursors,
                    len(self.scan.chunks),
                    self._select_messages(messages, topics, start, end, budget),
                )
            if cursors:
                _, number, rest, message = cursors[0]
                yield message
                following = next(rest, None)
                if following is None:
                    heapq.heappop(cursors)
                else:
                    heapq.heapreplace(cursors, (following.log_time, number, rest, following))

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
        place: ChunkPlace,
        names: Collection[str] | None,
        start: int | None,
        end: int | None,
        budget: MemoryBudget,
    ) -> Iterator[LogMessage]:
        messages = self._read_chunk(place)
        if messages is not None:
            yield from self._select_messages(messages, names, start, end, budget)

    def _select_messages(
        self,
        messages: Messages,
        names: Collection[str] | None,
        start: int | None,
        end: int | None,
        budget: MemoryBudget,
    ) -> Iterator[LogMessage]:
        streams = self.streams
        wanted = [id for id, stream in streams.items() if names is None or stream.topic in names]
        times: NDArray[np.int64] = messages.heads["log_time"]
        keep = np.isin(messages.heads["channel"], wanted)
        if start is not None:
            keep &= times >= start
        if end is not None:
            keep &= times < end
        chosen = np.flatnonzero(keep)
        chosen = chosen[np.argsort(times[chosen], kind="stable")]
        cost = 2 * messages.data.nbytes + _MESSAGE_MEMORY_BYTES * len(chosen)
        budget.claim(cost, "reading chunks that overlap in time")
        heads, data = messages.heads[chosen], messages.data.tobytes()
        starts = messages.places[chosen] + MESSAGE_HEADER.itemsize
        ends = starts + heads["length"].astype(np.int64) - 22
        columns = (
            heads["channel"],
            heads["log_time"],
            heads["publish_time"],
            heads["sequence"],
            starts,
            ends,
        )
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for channel, log_time, publish_time, sequence, begin, stop in rows:
            yield LogMessage(
                streams[channel].topic, log_time, publish_time, sequence, channel, data[begin:stop]
            )
        budget.release(cost)

    @property
    def _has_unlocated_damage(self) -> bool:
        """Whether the whole fails its checksum, and nothing that was read tells why."""
        return "data" in self.scan.doubts and not self.scan.damage

    @property
    def damage_count(self) -> int:
        """Places that could not be used or trusted; complete once the chunks were read."""
        return len(self.scan.damage) + self._has_unlocated_damage + ("summary" in self.scan.doubts)

    def warnings(self) -> tuple[str, ...]:
        """One line for each thing wrong with the file; complete once its chunks were read."""
        found, lines = self.scan, []
        for damage in sorted(found.damage, key=lambda damage: damage.offset):
            if damage.offset + damage.length >= found.size and not found.complete:
                continue
            lines.append(f"{found.path}: {self._describe_span(damage)}: {damage.reason}; it is left out")
        if not found.complete:
            lost = sum(d.length for d in found.damage if d.offset + d.length >= found.size)
            lines.append(
                f"{found.path}: was not closed: {self.messages_read} messages are kept, {lost} bytes at the "
                "end are lost; hubodo recover writes a whole one"
            )
        if self._has_unlocated_damage:
            lines.append(
                f"{found.path}: {found.doubts['data']}, and no part that was read is to blame: what stands "
                "between the chunks is damaged; metadata such as t = 0 and names of topics may be wrong"
            )
        if self._out_of_range:
            count = sum(self._out_of_range.values())
            lines.append(f"{found.path}: {count} messages have times beyond the year 2262; they are left out")
        if "summary" in found.doubts:
            lines.append(f"{found.path}: {found.doubts['summary']}; it is not used")
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
    """Open an MCAP file, whole, cut or damaged. Raises LogError when it is missing, empty or no MCAP."""
    path = Path(path)
    if path.is_dir():
        raise LogError(f"{path}: is a folder, not a log; import a CSV folder with hubodo import")
    return Log(scan(path))
