"""Write a recording as a series of complete logs, rotated by time and size, paused while the disk is full.

The chunk after the last one of a log is the first of the next, so nothing is lost at a rotation, and the
messages of all logs in order are those that a single log would contain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.disk_space import BYTES_PER_MB, DiskSpace, RotationRules, describe_error
from hubodo.log.disk_sync import SYNC_PERIOD_NS, Syncer, sync_folder
from hubodo.log.log_definitions import LogDefinitions
from hubodo.log.log_names import LogNames
from hubodo.log.mcap_file import Compression, McapFile, MessageIndexes, describe_loss
from hubodo.log.pending_chunks import PendingChunk, PendingChunks, count_messages
from hubodo.units import NS_PER_S

_CHECK_PERIOD_NS = NS_PER_S // 2
_BUDGET_PERIOD_NS = 5 * NS_PER_S
_FINAL_SYNC_TIMEOUT_S = 0.5
_SLOW_SYNC_LIMIT_NS = 5 * NS_PER_S // 2
_RESUME_RESERVE_FACTOR = 1.25
"""A paused recording resumes when this multiple of the reserve is free (hysteresis)."""
MAX_PENDING_BYTES = 16 * BYTES_PER_MB


class LogSeries:
    """A series of logs, the destination of a `ChunkWriter`, for one thread.

    out: see `LogNames`. now_ns: host clock. wait: if no log can be started now, start one later instead of
    raising InputError or OSError. A log that ends early (disk full or failed, file deleted) is reported in
    `notices`; chunks that arrive meanwhile are kept, up to 16 MB, and written first to the next log.
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
        """Why recording is paused; None while it is not."""
        self.paths: list[Path] = []
        self.messages_lost = 0
        self.closed = False
        self._names = LogNames(out, plain=not rules.is_rotating)
        self.disk_space = DiskSpace(self._names, rules.budget, self.notices.append)
        self._now_ns = now_ns
        self._syncer = syncer or Syncer()
        self._file: McapFile | None = None
        self._unfinished: McapFile | None = None
        self._finished_size = self._last_size = 0
        self._definitions = LogDefinitions()
        self._pending = PendingChunks()
        self._opened_ns = self._synced_size = self._sync_start_ns = 0
        self._next_check_ns = self._next_sync_ns = self._next_budget_ns = 0
        self._slow_sync_reported = False
        self._n_reported_logs = 0
        self._is_stopped, self._messages_while_stopped = False, 0
        try:
            self._start_log()
        except (InputError, OSError) as error:
            if not wait:
                self._syncer.close(0.0)
                raise
            self._pause(describe_error(error))

    @property
    def path(self) -> Path:
        """The open log, else the last one; the folder before the first."""
        return self.paths[-1] if self.paths else self._names.folder

    @property
    def size(self) -> int:
        """Bytes in all logs of the series."""
        return self._finished_size + self.open_size

    @property
    def open_size(self) -> int:
        """Bytes in the open log."""
        return self._file.size if self._file is not None else 0

    @property
    def is_recording(self) -> bool:
        """True while a log is open."""
        return self._file is not None

    @property
    def has_losses(self) -> bool:
        """True if messages were lost."""
        return self.messages_lost > 0

    def has_new_log(self) -> bool:
        """Return True if a new log, other than the first, has started since the last call."""
        is_new, self._n_reported_logs = (
            self._n_reported_logs != len(self.paths) and len(self.paths) > 1,
            len(self.paths),
        )
        return is_new

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema, written to each log on first use, and return its id."""
        return self._definitions.add_schema(name, encoding, data)

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Register a channel, written to each log before its first message, and return its id."""
        return self._definitions.add_channel(topic, encoding, schema_id, metadata)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record, now and at the start of each later log (the newest of each name)."""
        self._definitions.add_metadata(name, values)
        self._write(lambda file: file.add_metadata(name, values))

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Attach a file, now and to each later log."""
        self._definitions.add_attachment(name, media_type, data, time_ns)
        self._write(lambda file: file.add_attachment(name, media_type, data, time_ns))

    def add_chunk(self, records: bytes, indexes: MessageIndexes, compression: Compression) -> None:
        """Write a chunk as `McapFile.add_chunk` does; at a rotation it is written to one log as a whole."""
        if self._is_stopped:
            self._messages_while_stopped += count_messages(indexes)
            return
        if self._file is not None and self._is_rotation_due():
            self.rotate()
        self._pending.append(PendingChunk(records, indexes, compression))
        self._write_pending()
        while self._pending.byte_count > MAX_PENDING_BYTES:
            self.messages_lost += count_messages(self._pending.popleft().indexes)

    @property
    def unrecorded_messages(self) -> int:
        """Messages that were lost or arrived between `stop` and `resume`."""
        return self.messages_lost + self._messages_while_stopped

    def stop(self) -> None:
        """End the log by request of the user; messages from now on are discarded and do not count as lost."""
        if not self._is_stopped:
            self._is_stopped = True
            self._pending.clear()
            self._pause("recording is stopped by the user")
            if self._file is not None:
                self._end_log()

    def resume(self) -> None:
        """Start the next log after `stop`."""
        if self._is_stopped:
            self._is_stopped = False
            self._try_start_log()

    def rotate(self) -> None:
        """End the log and start the next one."""
        if self._file is None:
            self._try_start_log()
            return
        self._end_log()
        if self.pause_reason is None:
            self._try_start_log()

    def tick(self, now_ns: int) -> None:
        """Sync to disk and check disk and file when due; to be called about every 0.1 s."""
        self._sync_if_due(now_ns)
        if now_ns < self._next_check_ns:
            return
        self._next_check_ns = now_ns + _CHECK_PERIOD_NS
        if self._file is None:
            self._try_start_log()
        else:
            self._check_file(self._file)
        if now_ns >= self._next_budget_ns:
            self._next_budget_ns = now_ns + _BUDGET_PERIOD_NS
            self.disk_space.enforce_budget(self._in_use)

    def finish(self) -> None:
        """End the last log and wait up to half a second for its sync to disk. Idempotent."""
        if self.closed:
            return
        if self._file is None and self._pending:
            self._try_start_log()
        self.closed = True
        if self._file is not None:
            self._end_log()
        if self._unfinished is not None:
            self._close_unfinished(self._unfinished)
        self.messages_lost += self._pending.message_count
        self._pending.clear()
        self._syncer.close(_FINAL_SYNC_TIMEOUT_S)

    @property
    def _in_use(self) -> list[Path]:
        return [file.path for file in (self._file, self._unfinished) if file is not None]

    def _is_rotation_due(self) -> bool:
        after, at = self.rules.max_duration, self.rules.max_size
        assert self._file is not None
        return (after is not None and self._now_ns() >= self._opened_ns + after * NS_PER_S) or (
            at is not None and self._file.size >= at
        )

    def _start_log(self) -> None:
        """Start the next log with metadata and attachments. Raises InputError or OSError if impossible."""
        self.disk_space.enforce_budget(self._in_use, self.rules.max_size or self._last_size)
        n_bytes = float(self.rules.reserve)
        if self.pause_reason is not None:
            n_bytes = n_bytes * _RESUME_RESERVE_FACTOR + self._pending.byte_count
        shortage = self.disk_space.describe_shortage(n_bytes)
        if shortage is not None:
            raise InputError(shortage)
        now_ns = self._now_ns()
        file = McapFile(self._names.next_path(now_ns))
        try:
            self._definitions.begin_log(file)
        except OSError:
            file.close()
            file.path.unlink(missing_ok=True)
            raise
        self._file, self._opened_ns, self._synced_size = file, now_ns, 0
        self.paths.append(file.path)
        sync_folder(self._names.folder)

    def _end_log(self) -> None:
        """Write the footer of the open log and close it; if the disk is full, keep it for a later attempt."""
        assert self._file is not None
        file, self._file = self._file, None
        if (loss := describe_loss(file)) is not None:
            self.messages_lost += file.message_count
            self._finished_size += file.size
            self.notices.append(loss)
            file.close()
            return
        if self.pause_reason is not None and not file.message_count:
            file.close()
            file.path.unlink(missing_ok=True)
            self.paths.remove(file.path)
            return
        self._finished_size += file.size
        before = self._last_size = file.size
        try:
            file.write_footer()
        except OSError as error:
            self._unfinished = file
            if self.pause_reason is None:
                self._pause(describe_error(error))
            return
        self._finished_size += file.size - before
        self._syncer.enqueue(file.duplicate_descriptor())
        file.close()

    def _close_unfinished(self, file: McapFile) -> None:
        self._unfinished = None
        file.close()
        self.notices.append(
            f"{file.path}: has no index because the disk is full; `hubodo recover` completes it"
        )

    def _pause(self, reason: str) -> None:
        self.pause_reason = reason
        self.notices.append(f"{reason}; nothing is recorded until that is over")

    def _try_start_log(self) -> None:
        """Start another log if possible."""
        if self._is_stopped:
            return
        unfinished, self._unfinished = self._unfinished, None
        if unfinished is not None:
            try:
                unfinished.write_footer()
                unfinished.close()
                unfinished = None
            except OSError:
                pass  # the next log may still start: the file system may limit the size of one file
        try:
            self._start_log()
        except (InputError, OSError) as error:
            self._unfinished = unfinished
            if self.pause_reason is None:
                self._pause(describe_error(error))
            return
        if unfinished is not None:
            self._close_unfinished(unfinished)
        if self.pause_reason is not None:
            self.pause_reason = None
            self.notices.append(f"recording goes on in {self.path}")
        self._write_pending()

    def _write(self, write: Callable[[McapFile], None]) -> bool:
        """Write to the open log and return True; on OSError end the log, pause, and return False."""
        if self._file is None:
            return False
        try:
            write(self._file)
        except OSError as error:
            self._pause(f"{self._file.path}: {describe_error(error)}")
            self._end_log()
            return False
        return True

    def _write_pending(self) -> None:
        while self._pending and self._file is not None:
            if not self._write(self._write_oldest_pending):
                return
            self._pending.popleft()

    def _write_oldest_pending(self, file: McapFile) -> None:
        """Write the oldest pending chunk, preceded by the definitions of its channels."""
        chunk = self._pending[0]
        self._definitions.write_channels(file, chunk.indexes)
        file.add_chunk(chunk.records, chunk.indexes, chunk.compression)

    def _check_file(self, file: McapFile) -> None:
        """Pause if the disk is nearly full; start another log if the open one was moved or damaged."""
        state = file.file_state()
        if state != "in place":
            self._handle_displaced_file(file, state)
            return
        self.disk_space.make_room(self.rules.reserve, self._in_use)
        shortage = self.disk_space.describe_shortage(self.rules.reserve)
        if shortage is not None:
            self._pause(shortage)
            self._end_log()

    def _handle_displaced_file(self, file: McapFile, state: str) -> None:
        if state == "moved":
            self.notices.append(f"{file.path}: was moved; it is complete at its new place")
        self._end_log()
        self._try_start_log()
        if self._file is not None:
            self.notices.append(f"recording goes on in {self.path}")

    def _sync_if_due(self, now_ns: int) -> None:
        why = self._syncer.pop_error()
        if why is not None and self._file is not None:
            self._pause(f"{self._file.path}: the disk failed: {why}")
            self._end_log()
        if self._syncer.is_busy:
            if now_ns - self._sync_start_ns > _SLOW_SYNC_LIMIT_NS and not self._slow_sync_reported:
                self._slow_sync_reported = True
                self.notices.append(
                    "the disk takes more than 2.5 s to write; a power cut may cost more than 5 s"
                )
            return
        if self._file is None or now_ns < self._next_sync_ns or self._file.size == self._synced_size:
            return
        self._next_sync_ns, self._sync_start_ns = now_ns + SYNC_PERIOD_NS, now_ns
        self._synced_size = self._file.size
        self._syncer.enqueue(self._file.duplicate_descriptor())
