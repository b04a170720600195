"""Protect a log against power cuts by syncing the written data to disk every few seconds."""

from __future__ import annotations

import os
import queue
import threading
from pathlib import Path

from hubodo.units import NS_PER_S

SYNC_PERIOD_NS = 2 * NS_PER_S
"""With half a second of pending messages and a sync of up to 2.5 s, a power cut loses at most 5 s of data."""


def sync_file(fd: int) -> None:
    """Sync the written data to disk; may block for seconds. Raises OSError if the disk failed."""
    getattr(os, "fdatasync", os.fsync)(fd)


def sync_folder(folder: Path) -> None:
    """Sync the name of a new file to disk; systems without this call do it by themselves."""
    try:
        fd = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(fd)
    except OSError:
        pass  # some file systems refuse it for folders
    finally:
        os.close(fd)


class Syncer:
    """A thread that syncs files to disk, because a sync can block for seconds.

    It owns the descriptors that it is given. Errors are kept until `pop_error`.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self._counts = [0, 0]  # syncs requested by one thread, finished by the other
        self._errors: list[str] = []
        self._thread = threading.Thread(target=self._run, daemon=True, name="sync")
        self._thread.start()

    @property
    def is_busy(self) -> bool:
        """True while a requested sync is not finished."""
        return self._counts[0] != self._counts[1]

    def enqueue(self, fd: int) -> None:
        """Request a sync of the data written to `fd`, which is closed afterwards."""
        self._counts[0] += 1
        self._queue.put(fd)

    def pop_error(self) -> str | None:
        """Return the oldest error of a sync and remove it; None without errors."""
        return self._errors.pop(0) if self._errors else None

    def close(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s` for the requested syncs; return True if all are finished."""
        self._queue.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (fd := self._queue.get()) is not None:
            try:
                sync_file(fd)
            except OSError as error:
                self._errors.append(error.strerror or str(error))
            finally:
                os.close(fd)
                self._counts[1] += 1
