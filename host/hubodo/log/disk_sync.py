"""A log made safe against a power cut: what was written is brought onto the disk every few seconds."""

from __future__ import annotations

import os
import queue
import threading
from pathlib import Path

from hubodo.units import NS_PER_S

SYNC_PERIOD_NS = 2 * NS_PER_S
"""With half a second in which messages wait for their chunk, a disk may take 2.5 s and no more than 5 s
are lost.
"""


def sync_file(fd: int) -> None:
    """Everything written so far onto the disk; may take seconds. Raises OSError where the disk failed."""
    getattr(os, "fdatasync", os.fsync)(fd)


def sync_folder(folder: Path) -> None:
    """The name of a new file onto the disk; where a system cannot do that, it does it by itself."""
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
    """Brings files onto the disk from a thread of its own, because that can block for seconds.

    It takes over the descriptors it is given. What fails is in `failed` until it is asked for.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self._counts = [0, 0]  # given by one thread, done by the other
        self._errors: list[str] = []
        self._thread = threading.Thread(target=self._run, daemon=True, name="sync")
        self._thread.start()

    @property
    def is_busy(self) -> bool:
        """Whether something that was given is not on the disk yet."""
        return self._counts[0] != self._counts[1]

    def enqueue(self, fd: int) -> None:
        """What is written to `fd` so far, soon; `fd` is closed then."""
        self._counts[0] += 1
        self._queue.put(fd)

    def pop_error(self) -> str | None:
        """Why the disk did not take something, once for each time."""
        return self._errors.pop(0) if self._errors else None

    def close(self, timeout_s: float) -> bool:
        """Waits so long for what was given; whether it is all on the disk."""
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
