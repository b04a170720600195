"""Limits on the memory and files that an untrusted log may use, checked before anything is allocated.

Sizes in a file's header are claims by whoever wrote the file: they are compared with a memory limit, paths
must name regular files, and compressed data are expanded only up to the limit.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from io import FileIO
from pathlib import Path

from hubodo.errors import InputError

DEFAULT_MEMORY_FRACTION = 0.25
"""Fraction of the machine's memory that reading one file may use unless --max-memory is given."""
FALLBACK_MEMORY_BYTES = 8 << 30  # bytes; assumed where the system does not report its memory
_CGROUP_LIMIT_FILE = Path("/sys/fs/cgroup/memory.max")
READ_BLOCK_BYTES = 1 << 20  # bytes
_MAX_PRINTED_BYTES = 10**18  # bytes
_limit: ContextVar[int | None] = ContextVar("memory limit in bytes", default=None)


def limit_bytes() -> int:
    """Return the memory in bytes that reading one file may take."""
    limit = _limit.get()
    return int(machine_memory() * DEFAULT_MEMORY_FRACTION) if limit is None else limit


@contextmanager
def memory_limit(n_bytes: int | None) -> Iterator[None]:
    """Apply a memory limit within a block; None leaves the limit unchanged."""
    if n_bytes is None:
        yield
        return
    token = _limit.set(n_bytes)
    try:
        yield
    finally:
        _limit.reset(token)


def machine_memory() -> int:
    """Return the memory of the machine, or of the container where that is less, in bytes."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):  # Windows has no sysconf
        memory = FALLBACK_MEMORY_BYTES
    try:
        return min(memory, int(_CGROUP_LIMIT_FILE.read_text("ascii")))
    except (OSError, ValueError):  # no container, or "max"
        return memory


class MemoryBudget:
    """The memory budget for reading one file; each claim is deducted before anything is allocated.

    path: named in the error. limit: bytes, `limit_bytes()` by default. limit_name, remedy: error texts.
    """

    def __init__(
        self,
        path: Path,
        limit: int | None = None,
        limit_name: str = "of memory, the limit",
        remedy: str = "raise it with --max-memory if the file is genuine",
    ) -> None:
        self.path = path
        self.limit = limit_bytes() if limit is None else limit
        self.limit_name, self.remedy = limit_name, remedy
        self.claimed = 0

    def claim(self, n_bytes: int, purpose: str) -> None:
        """Deduct a claim. Raises InputError, which names `purpose`, if it is negative or beyond the limit."""
        if n_bytes < 0:
            raise InputError(
                f"{self.path}: {purpose} has a negative size ({n_bytes} bytes); save the file again"
            )
        self.claimed += n_bytes
        if self.claimed > self.limit:
            raise InputError(
                f"{self.path}: {purpose} needs {_megabytes(self.claimed)} {self.limit_name} is "
                f"{_megabytes(self.limit)}; {self.remedy}"
            )

    def release(self, n_bytes: int) -> None:
        """Return the claimed bytes to the budget after their memory was freed."""
        self.claimed -= n_bytes


def file_budget(path: Path, n_bytes: int) -> MemoryBudget:
    """Return a budget of the bytes that a file of its size can hold, whatever the memory limit."""
    return MemoryBudget(path, n_bytes, "of room, the most for a file of its size", "copy or record it again")


def max_expanded_bytes(size: int, minimum: int = 1 << 26) -> int:
    """Return the largest plausible expanded size of a compressed file of `size` bytes.

    Message headers and time stamps differ from row to row, so no recording compresses below 1/256; a file
    that claims more is damaged or malicious.
    """
    return minimum + 256 * size


def check_claim(n_bytes: int, path: Path, purpose: str) -> None:
    """Check one claimed size against the memory limit. Raises InputError as `MemoryBudget.claim` does."""
    MemoryBudget(path).claim(n_bytes, purpose)


def open_regular(path: Path) -> FileIO:
    """Open a regular file for reading, unbuffered.

    A FIFO, a socket or a device is refused: opening a FIFO would wait for a writer, reading a device may
    never end. Raises InputError for those, OSError where the file cannot be opened.
    """
    flags = os.O_RDONLY
    for name in ("O_CLOEXEC", "O_BINARY", "O_NONBLOCK", "O_NOCTTY"):
        flags |= getattr(os, name, 0)
    fd = os.open(path, flags)
    try:
        if not stat.S_ISREG(os.fstat(fd).st_mode) and not stat.S_ISDIR(os.fstat(fd).st_mode):
            raise InputError(f"{path}: is not a regular file but a pipe or a device; copy its data to a file")
        return os.fdopen(fd, "rb", buffering=0)  # raises IsADirectoryError for a folder
    except BaseException:
        os.close(fd)
        raise


def check_regular(path: Path) -> None:
    """Refuse a path that exists and is neither a regular file nor a folder. Raises InputError."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return  # opening it reports the reason
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(f"{path}: is not a regular file but a pipe or a device; copy its data to a file")


def _megabytes(n_bytes: int) -> str:
    if n_bytes >= _MAX_PRINTED_BYTES:  # a product of claimed lengths may have any number of digits
        return "over an exabyte"
    return f"{n_bytes / 1e6:.0f} MB" if n_bytes >= 1e6 else f"{n_bytes} bytes"
