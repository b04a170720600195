"""The logs of one recording, one after the other: whole each, cut by time and size, paused without room.

What follows the last chunk of one log is the first of the next, so that nothing is lost at a cut, and the
messages of all of them, in their order, are those that a single log would hold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, Schema

from hubodo.errors import InputError
from hubodo.log.disk_space import BYTES_PER_MB, DiskSpace, describe_error
from hubodo.log.disk_sync import SYNC_PERIOD_NS, Syncer, sync_folder
from hubodo.log.log_names import LogNames
from hubodo.log.lost_logs import loss_words
from hubodo.log.mcap_file import Compression, McapFile, MessageIndexes
from hubodo.log.pending_chunks import HeldChunk, HeldChunks, messages_in
from hubodo.units import NS_PER_S

_LOOK_NS = NS_PER_S // 2
_BUDGET_NS = 5 * NS_PER_S
_SYNC_S = 0.5
_SLOW_SYNC_NS = 5 * NS_PER_S // 2
_ROOM_AGAIN = 1.25
"""Times the reserve; between the two neither a log ends nor one begins."""
HELD_BYTES = 16 * BYTES_PER_MB


@dataclass(frozen=True, slots=True)
class RotationRules:
    """When a log is cut, and what it must leave on the disk.

    after: s, at: bytes, after which the next log begins; None: never. budget: bytes for all logs of this
    name in the folder, the oldest closed ones are removed beyond that; None: nothing is ever removed.
    reserve: bytes that stay free on the disk; recording pauses before they are taken.
    """

    max_duration: float | None = None
    max_size: int | None = None
    budget: int | None = None
    reserve: int = 0

    @property
    def is_rotating(self) -> bool:
        """Whether there will be more than one log."""
        return self.max_duration is not None or self.max_size is not None


class LogSeries:
    """Takes what a `ChunkLog` writes; one thread only.

    out: see `LogNames`. now_ns: host time. wait: begin later where no log can begin now, else that raises
    InputError or OSError. A log that ends early (no room, its disk failed, it was deleted) is told in
    `notices`; what comes meanwhile is held, up to 16 MB, and goes first into the next one.
    """

    def __init__(
        self,
        out: Path,
        rules: RotationRules,
        now_ns: Callable[[], int],
        *,
        wait: bool = False,
        syncer: Syncer | None = None,
    ) -> None:
        self.rules = rules
        self.notices: list[str] = []
        self.pause_reason: str | None = None
        """Why nothing is recorded now."""
        self.paths: list[Path] = []
        self.messages_lost = 0
        self.closed = False
        self._names = LogNames(out, plain=not rules.is_rotating)
        self.disk_space = DiskSpace(self._names, rules.budget, self.notices.append)
        self._now_ns = now_ns
        self._sync = syncer or Syncer()
        self._file: McapFile | None = None
        self._unsealed: McapFile | None = None
        self._finished = self._last_size = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._announced: set[int] = set()
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: dict[str, tuple[str, bytes, int]] = {}
        self._held = HeldChunks()
        self._opened_ns = self._synced = self._sync_began_ns = 0
        self._next_look = self._next_sync = self._next_budget = 0
        self._slow_said = False
        self._told = 0
        self._halted, self._unwanted = False, 0
        try:
            self._begin()
        except (InputError, OSError) as error:
            if not wait:
                self._sync.close(0.0)
                raise
            self._paused(describe_error(error))

    @property
    def path(self) -> Path:
        """The log that is open, else the last one; the folder before the first."""
        return self.paths[-1] if self.paths else self._names.folder

    @property
    def size(self) -> int:
        """Bytes in all logs so far."""
        return self._finished + self.open_size

    @property
    def open_size(self) -> int:
        """Bytes in the log that is open."""
        return self._file.size if self._file is not None else 0

    @property
    def is_recording(self) -> bool:
        """Whether a log is open."""
        return self._file is not None

    @property
    def has_losses(self) -> bool:
        """Whether something that was to be recorded is in no log."""
        return self.messages_lost > 0

    def has_new_log(self) -> bool:
        """Whether another log has begun since the last call; the first log does not count."""
        again, self._told = self._told != len(self.paths) and len(self.paths) > 1, len(self.paths)
        return again

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """A schema, written where a log first needs it; returns its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas[schema.id] = schema
        return schema.id

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """A channel, written where a log first has a message of it; returns its id."""
        number = len(self._channels) + 1
        self._channels[number] = Channel(
            id=number,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema_id,
            metadata=dict(metadata),
        )
        return number

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """A metadata record, the newest of its name also at the head of each log to come."""
        self._metadata[name] = dict(values)
        self._write(lambda file: file.add_metadata(name, values))

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """A file, also in each log to come."""
        self._attachments[name] = (media_type, data, time_ns)
        self._write(lambda file: file.add_attachment(name, media_type, data, time_ns))

    def add_chunk(self, records: bytes, indexes: MessageIndexes, compression: Compression) -> None:
        """See `McapFile.add_chunk`; the log before or behind a cut has all of it."""
        if self._halted:
            self._unwanted += messages_in(indexes)
            return
        if self._file is not None and self._due():
            self.rotate()
        self._held.append(HeldChunk(records, indexes, compression))
        self._write_held()
        while self._held.size > HELD_BYTES:
            self.messages_lost += messages_in(self._held.popleft().indexes)

    @property
    def unrecorded_messages(self) -> int:
        """Messages that are lost, or came between `halt` and `go_on`."""
        return self.messages_lost + self._unwanted

    def stop(self) -> None:
        """Ends the log because the user wants it; what comes from now on is in none, and not lost."""
        if not self._halted:
            self._halted = True
            self._held.clear()
            self._paused("recording is stopped by the user")
            if self._file is not None:
                self._end()

    def resume(self) -> None:
        """Begins the next log after `halt`."""
        if self._halted:
            self._halted = False
            self._try_again()

    def rotate(self) -> None:
        """Ends the log and begins the next one."""
        if self._file is None:
            self._try_again()
            return
        self._end()
        if self.pause_reason is None:
            self._try_again()

    def tick(self, now_ns: int) -> None:
        """Call every 0.1 s or so: syncs what is due, and notices what happens to the disk and the file."""
        self._sync_if_due(now_ns)
        if now_ns < self._next_look:
            return
        self._next_look = now_ns + _LOOK_NS
        if self._file is None:
            self._try_again()
        else:
            self._look(self._file)
        if now_ns >= self._next_budget:
            self._next_budget = now_ns + _BUDGET_NS
            self.disk_space.enforce_budget(self._in_use)

    def finish(self) -> None:
        """Ends the last log, and waits half a second for the disk to have it. Idempotent."""
        if self.closed:
            return
        if self._file is None and self._held:
            self._try_again()
        self.closed = True
        if self._file is not None:
            self._end()
        if self._unsealed is not None:
            self._give_up(self._unsealed)
        self.messages_lost += self._held.messages
        self._held.clear()
        self._sync.close(_SYNC_S)

    @property
    def _in_use(self) -> list[Path]:
        return [file.path for file in (self._file, self._unsealed) if file is not None]

    def _due(self) -> bool:
        after, at = self.rules.max_duration, self.rules.max_size
        assert self._file is not None
        return (after is not None and self._now_ns() >= self._opened_ns + after * NS_PER_S) or (
            at is not None and self._file.size >= at
        )

    def _begin(self) -> None:
        """The next log, with what stands at the head of each; raises InputError or OSError without one."""
        self.disk_space.enforce_budget(self._in_use, self.rules.max_size or self._last_size)
        wanted = float(self.rules.reserve)
        if self.pause_reason is not None:
            wanted = wanted * _ROOM_AGAIN + self._held.size
        lacking = self.disk_space.describe_shortage(wanted)
        if lacking is not None:
            raise InputError(lacking)
        now_ns = self._now_ns()
        file = McapFile(self._names.next_path(now_ns))
        try:
            for name, values in self._metadata.items():
                file.add_metadata(name, values)
            for name, (media_type, data, time_ns) in self._attachments.items():
                file.add_attachment(name, media_type, data, time_ns)
        except OSError:
            file.close_without_footer()
            file.path.unlink(missing_ok=True)
            raise
        self._file, self._opened_ns, self._synced = file, now_ns, 0
        self._announced.clear()
        self.paths.append(file.path)
        sync_folder(self._names.folder)

    def _end(self) -> None:
        """Footer and name of the open log are final; a log without room for its footer waits for some."""
        assert self._file is not None
        file, self._file = self._file, None
        if (loss := loss_words(file)) is not None:
            self.messages_lost += file.message_count
            self._finished += file.size
            self.notices.append(loss)
            file.close_without_footer()
            return
        if self.pause_reason is not None and not file.message_count:
            file.close_without_footer()
            file.path.unlink(missing_ok=True)
            self.paths.remove(file.path)
            return
        self._finished += file.size
        before = self._last_size = file.size
        try:
            file.write_footer()
        except OSError as error:
            self._unsealed = file
            if self.pause_reason is None:
                self._paused(describe_error(error))
            return
        self._finished += file.size - before
        self._sync.enqueue(file.duplicate_descriptor())
        file.close_without_footer()

    def _give_up(self, file: McapFile) -> None:
        self._unsealed = None
        file.close_without_footer()
        self.notices.append(
            f"{file.path}: has no index for want of room; it can be read, and `hubodo recover` makes it whole"
        )

    def _paused(self, why: str) -> None:
        self.pause_reason = why
        self.notices.append(f"{why}; nothing is recorded until that is over")

    def _try_again(self) -> None:
        """Another log, where one can begin now."""
        if self._halted:
            return
        unsealed, self._unsealed = self._unsealed, None
        if unsealed is not None:
            try:
                unsealed.write_footer()
                unsealed.close_without_footer()
                unsealed = None
            except OSError:
                pass  # the next log may begin all the same: there is a limit to the size of one file
        try:
            self._begin()
        except (InputError, OSError) as error:
            self._unsealed = unsealed
            if self.pause_reason is None:
                self._paused(describe_error(error))
            return
        if unsealed is not None:
            self._give_up(unsealed)
        if self.pause_reason is not None:
            self.pause_reason = None
            self.notices.append(f"recording goes on in {self.path}")
        self._write_held()

    def _write(self, write: Callable[[McapFile], None]) -> bool:
        """Whether the open log took it; one that did not ends, and is told."""
        if self._file is None:
            return False
        try:
            write(self._file)
        except OSError as error:
            self._paused(f"{self._file.path}: {describe_error(error)}")
            self._end()
            return False
        return True

    def _write_held(self) -> None:
        while self._held and self._file is not None:
            if not self._write(self._write_first):
                return
            self._held.popleft()

    def _write_first(self, file: McapFile) -> None:
        """The chunk that waits longest, behind what the log must know of its channels."""
        held = self._held[0]
        for number in sorted(held.indexes.keys() - self._announced):
            channel = self._channels[number]
            if channel.schema_id and -channel.schema_id not in self._announced:
                file.copy_schema(self._schemas[channel.schema_id])
                self._announced.add(-channel.schema_id)
            file.copy_channel(channel)
            self._announced.add(number)
        file.add_chunk(held.records, held.indexes, held.compression)

    def _look(self, file: McapFile) -> None:
        """Whether the open log is still where it was, with room to grow."""
        where = file.file_state()
        if where != "here":
            self._lost_sight(file, where)
            return
        self.disk_space.free_bytes(self.rules.reserve, self._in_use)
        lacking = self.disk_space.describe_shortage(self.rules.reserve)
        if lacking is not None:
            self._paused(lacking)
            self._end()

    def _lost_sight(self, file: McapFile, where: str) -> None:
        if where == "elsewhere":
            self.notices.append(f"{file.path}: was moved away; it is whole where it is now")
        self._end()
        self._try_again()
        if self._file is not None:
            self.notices.append(f"recording goes on in {self.path}")

    def _sync_if_due(self, now_ns: int) -> None:
        why = self._sync.pop_error()
        if why is not None and self._file is not None:
            self._paused(f"{self._file.path}: the disk failed: {why}")
            self._end()
        if self._sync.is_busy:
            if now_ns - self._sync_began_ns > _SLOW_SYNC_NS and not self._slow_said:
                self._slow_said = True
                self.notices.append(
                    "the disk takes more than 2.5 s to write; a power cut may cost more than 5 s"
                )
            return
        if self._file is None or now_ns < self._next_sync or self._file.size == self._synced:
            return
        self._next_sync, self._sync_began_ns = now_ns + SYNC_PERIOD_NS, now_ns
        self._synced = self._file.size
        self._sync.enqueue(self._file.duplicate_descriptor())
