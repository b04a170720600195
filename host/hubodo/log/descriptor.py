"""Files by descriptor on every system: opened as bytes, closed in child processes, read at a place."""

from __future__ import annotations

import os
from pathlib import Path

_FLAGS = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)  # each has one of them; Linux and Windows


def open_to_read(path: Path) -> int:
    """A descriptor. Raises OSError."""
    return os.open(path, os.O_RDONLY | _FLAGS)


def open_new(path: Path) -> int:
    """Return a descriptor that appends. Raises OSError, FileExistsError where there is a file.

    Appending leaves no hole where another program shortens the file, so its size shows that somebody did.
    """
    return os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL | _FLAGS, 0o644)


def _seek_and_read(fd: int, size: int, offset: int) -> bytes:
    """As `os.pread`, for the only user of a descriptor."""
    os.lseek(fd, offset, os.SEEK_SET)
    return os.read(fd, size)


pread = getattr(os, "pread", _seek_and_read)
"""Up to so many bytes of a descriptor from an offset on; Windows has it not."""
