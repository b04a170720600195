"""Open files as descriptors and read at an offset, on Linux, macOS and Windows."""

from __future__ import annotations

import os
from pathlib import Path

_OPEN_FLAGS = getattr(os, "O_CLOEXEC", 0) | getattr(
    os, "O_BINARY", 0
)  # POSIX has the first, Windows the second


def open_read_only(path: Path) -> int:
    """Return a descriptor for reading. Raises OSError."""
    return os.open(path, os.O_RDONLY | _OPEN_FLAGS)


def create_append_only(path: Path) -> int:
    """Create a file and return a descriptor that appends. Raises OSError; FileExistsError if the path exists.

    If another program truncates the file, appending leaves no hole, so the size reveals the truncation.
    """
    return os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_EXCL | _OPEN_FLAGS, 0o644)


def _seek_and_read(fd: int, size: int, offset: int) -> bytes:
    """Replace `os.pread` where it is missing; the descriptor must have a single user."""
    os.lseek(fd, offset, os.SEEK_SET)
    return os.read(fd, size)


pread = getattr(os, "pread", _seek_and_read)
"""pread(fd, size, offset): read up to `size` bytes at an offset."""
