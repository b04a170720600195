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
from hubodo.log.chunk_body import (
    MEMORY_PER_BYTE,
    ChunkPlace,
    DamagedChunk,
    Messages,
    announced,
    load,
    load_cut,
    walk,
)
from hubodo.log.claims import MemoryBudget, check_claim, room_of
from hubodo.log.descriptor import open_to_read
from hubodo.log.message_records import PREFIX
from hubodo.log.scan import DamagedSpan, Scan, scan
from hubodo.log.source import Facts, Stream

_ROW_MEMORY = 300  # bytes per message of a chunk that waits for its turn: six numbers of Python
T_ZERO_LIMIT = 4_000_000_000 * 1_000_000_000
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
        self.found = found
        self._fd = open_to_read(found.path)
        self.kept = 0
        """Messages met so far by `chunks()`."""
        self._position = 0
        self._streams: dict[int, Stream] = {}
        self._known = (0, 0)
        """Channels and schemas that `_streams` was made of."""
        self._impossible: dict[int, int] = {}
        """Messages beyond the times of the format, by the offset of their chunk."""

    @property
    def path(self) -> Path:
        """The file."""
        return self.found.path

    @property
    def facts(self) -> Facts:
        """Size, writer, profile, whether it was closed, what is damaged."""
        found = self.found
        files = {name: len(data) for name, data in self.attachments.items()}
        return Facts(found.size, found.library, found.profile, found.complete, files, self.damaged)

    @property
    def streams(self) -> dict[int, Stream]:
        """The channels known so far, by id; where they stand inside chunks, complete once `chunks()` ran."""
        schemas = self.found.schemas
        if (len(self.found.channels), len(schemas)) == self._known:
            return self._streams
        self._known = len(self.found.channels), len(schemas)
        for id, channel in self.found.channels.items():
            known = self._streams.get(id)
            if known is None or (channel.schema_id in schemas and not known.schema):
                schema = schemas[channel.schema_id].name if channel.schema_id in schemas else ""
                metadata = dict(channel.metadata)
                self._streams[id] = Stream(id, channel.topic, schema, channel.message_encoding, metadata)
        return self._streams

    @property
    def records(self) -> dict[str, dict[str, str]]:
        """Metadata records by name."""
        return {record.name: dict(record.metadata) for record in self.found.metadata}

    @property
    def attachments(self) -> dict[str, bytes]:
        """Files kept in the log, by name."""
        return {file.name: bytes(file.data) for file in self.found.attachments}

    @property
    def metadata(self) -> dict[str, str]:
        """The record `hubodo`, and the others with their name and a dot before each key."""
        flat: dict[str, str] = {}
        for name, values in self.records.items():
            prefix = "" if name == topics.METADATA else name + "."
            flat.update({prefix + key: value for key, value in values.items()})
        return flat

    @property
    def t_zero_ns(self) -> int | None:
        """Host time of t = 0 as the log states it; None where it does not, or not a time that can be."""
        text = self.metadata.get(topics.T_ZERO, "")
        stated = int(text) if text.isascii() and text.isdigit() and len(text) < 20 else -1
        return stated if 0 <= stated < T_ZERO_LIMIT else None

    @property
    def progress(self) -> float:
        """Fraction of the file that `chunks()` has gone through."""
        return self._position / max(1, self.found.size)

    def chunks(self) -> Iterator[Messages]:
        """All messages, a chunk at a time in file order; damage is noted and passed over."""
        self.kept = 0
        for place in self.found.chunks:
            self._position = place.offset + place.length
            messages = self._messages(place)
            if messages is not None:
                self.kept += len(messages.places)
                yield messages
        if self.found.cut is not None:
            messages = self._cut_messages(self.found.cut)
            self.kept += len(messages.places)
            yield messages

    def _messages(self, place: ChunkPlace) -> Messages | None:
        if place.offset in self.found.unbelievable:
            self.found.note(place, f"chunk claims {place.size} bytes, more than such a file can hold")
            return None
        check_claim(MEMORY_PER_BYTE * place.size, self.path, "a chunk")
        try:
            messages = walk(load(self._fd, place), announced(self._fd, place))
        except DamagedChunk as error:
            self.found.note(place, f"chunk {error}")
            return None
        self.found.learn(messages.definitions)
        if not messages.whole:
            self.found.note(place, "chunk ends in nonsense")
        possible = (messages.heads["log_time"] >= 0) & (messages.heads["publish_time"] >= 0)
        if not possible.all():
            self._impossible[place.offset] = int(np.count_nonzero(~possible))
            messages = replace(messages, places=messages.places[possible], heads=messages.heads[possible])
        return messages

    def _cut_messages(self, place: ChunkPlace) -> Messages:
        check_claim(min(MEMORY_PER_BYTE * place.size, room_of(place.data_size)), self.path, "its last chunk")
        # No checksum vouches for a part; the times that the chunk's head announces are some guard.
        messages = walk(load_cut(self._fd, place)).between(place.start_ns, place.end_ns)
        self.found.learn(messages.definitions)
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
            for number, place in enumerate(self.found.chunks)
            if (start is None or place.end_ns >= start) and (end is None or place.start_ns < end)
        ]
        waiting.sort(key=lambda numbered: numbered[1].start_ns, reverse=True)
        cut = self.found.cut
        cursors: list[tuple[int, int, Iterator[LogMessage], LogMessage]] = []
        while waiting or cursors or cut is not None:
            while waiting and (not cursors or waiting[-1][1].start_ns <= cursors[0][0]):
                number, place = waiting.pop()
                self._push(cursors, number, self._ordered(place, topics, start, end, budget))
            if cut is not None and not waiting:
                messages, cut = self._cut_messages(cut), None
                self._push(
                    cursors, len(self.found.chunks), self._select(messages, topics, start, end, budget)
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
    def _push(
        cursors: list[tuple[int, int, Iterator[LogMessage], LogMessage]],
        number: int,
        messages: Iterator[LogMessage],
    ) -> None:
        first = next(messages, None)
        if first is not None:
            heapq.heappush(cursors, (first.log_time, number, messages, first))

    def _ordered(
        self,
        place: ChunkPlace,
        names: Collection[str] | None,
        start: int | None,
        end: int | None,
        budget: MemoryBudget,
    ) -> Iterator[LogMessage]:
        messages = self._messages(place)
        if messages is not None:
            yield from self._select(messages, names, start, end, budget)

    def _select(
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
        cost = 2 * messages.data.nbytes + _ROW_MEMORY * len(chosen)
        budget.claim(cost, "reading chunks that overlap in time")
        heads, data = messages.heads[chosen], messages.data.tobytes()
        starts = messages.places[chosen] + PREFIX.itemsize
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
    def _unplaced(self) -> bool:
        """Whether the whole fails its checksum, and nothing that was read tells why."""
        return "data" in self.found.doubts and not self.found.damage

    @property
    def damaged(self) -> int:
        """Places that could not be used or trusted; complete once the chunks were read."""
        return len(self.found.damage) + self._unplaced + ("summary" in self.found.doubts)

    def warnings(self) -> tuple[str, ...]:
        """One line for each thing wrong with the file; complete once its chunks were read."""
        found, lines = self.found, []
        for damage in sorted(found.damage, key=lambda damage: damage.offset):
            if damage.offset + damage.length >= found.size and not found.complete:
                continue
            lines.append(f"{found.path}: {self._place(damage)}: {damage.reason}; it is left out")
        if not found.complete:
            lost = sum(d.length for d in found.damage if d.offset + d.length >= found.size)
            lines.append(
                f"{found.path}: was not closed: {self.kept} messages are kept, {lost} bytes at the end are "
                "lost; hubodo recover writes a whole one"
            )
        if self._unplaced:
            lines.append(
                f"{found.path}: {found.doubts['data']}, and no part that was read is to blame: what stands "
                "between the chunks is damaged; metadata such as t = 0 and names of topics may be wrong"
            )
        if self._impossible:
            count = sum(self._impossible.values())
            lines.append(f"{found.path}: {count} messages have times beyond the year 2262; they are left out")
        if "summary" in found.doubts:
            lines.append(f"{found.path}: {found.doubts['summary']}; it is not used")
        return tuple(lines)

    def _place(self, damage: DamagedSpan) -> str:
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
