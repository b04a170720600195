"""System calls of a log writer, recorded, refused with real error numbers, or delayed."""

from __future__ import annotations

import errno
import os
import threading
import time
from pathlib import Path

import pytest


class TracedDisk:
    """A context manager that intercepts system calls on all files ending in .mcap.

    refuses: error number of each write, or None; largest_file: maximum size of a file, bytes, as on FAT.
    moments: after each write that `settle` has covered, (host time, {file: bytes that would survive a power
    cut}).
    """

    def __init__(self) -> None:
        self.refuses: int | None = None
        self.largest_file: int | None = None
        self.moments: list[tuple[int, dict[str, bytes]]] = []
        self._safe: dict[str, bytes] = {}
        self._written = self._settled_writes = 0
        self._released = threading.Event()
        self._released.set()
        self._patch = pytest.MonkeyPatch()

    def __enter__(self) -> TracedDisk:
        self._write, self._sync = os.write, os.fdatasync
        self._patch.setattr(os, "write", self._traced_write)
        self._patch.setattr(os, "fdatasync", self._traced_sync)
        return self

    def __exit__(self, *_: object) -> None:
        self.go_on()
        self._patch.undo()

    def hang(self) -> None:
        """Block all syncs from now on."""
        self._released.clear()

    def go_on(self) -> None:
        """Release the blocked syncs."""
        self._released.set()

    def settle(self, series: object, now_ns: int) -> None:
        """Let a started sync finish and record the bytes that a power cut would leave."""
        while series._syncer.is_busy:
            time.sleep(0.0002)
        if self._written != self._settled_writes:
            self._settled_writes = self._written
            self.moments.append((now_ns, dict(self._safe)))

    def _traced_write(self, fd: int, data: bytes) -> int:
        if not self._is_log(fd):
            return self._write(fd, data)
        if self.refuses is not None:
            raise OSError(self.refuses, os.strerror(self.refuses))
        full = self.largest_file
        if full is not None and os.fstat(fd).st_size + len(data) > full:
            self.largest_file = os.fstat(fd).st_size
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
        self._written += 1
        return self._write(fd, data)

    def _traced_sync(self, fd: int) -> None:
        size = os.fstat(fd).st_size
        self._released.wait(60)
        path = Path(f"/proc/self/fd/{fd}").readlink()
        self._safe[path.name] = path.read_bytes()[:size]
        self._sync(fd)

    def _is_log(self, fd: int) -> bool:
        return Path(f"/proc/self/fd/{fd}").readlink().suffix == ".mcap"
