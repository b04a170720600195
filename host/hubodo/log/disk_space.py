"""Room for logs: what is left on their disk, and the oldest of them removed where a budget says so."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection
from pathlib import Path

from hubodo.log.log_names import LogNames

BYTES_PER_MB = 1_000_000


class DiskSpace:
    """Of the disk on which a recording's logs are. budget: bytes for all of them, None: none is ever removed.

    say: gets a line for each that is removed, or cannot be.
    """

    def __init__(self, names: LogNames, budget: int | None, report: Callable[[str], None]) -> None:
        self.removed = 0
        self._names = names
        self._budget = budget
        self._report = report

    def free_and_total(self) -> tuple[int, int] | None:
        """Bytes free and in all; None where the folder is not there."""
        try:
            usage = shutil.disk_usage(self._names.folder)
        except OSError:
            return None
        return usage.free, usage.total

    def describe_shortage(self, n_bytes: float) -> str | None:
        """Where less than that many bytes are free: how much is, in words."""
        disk = self.free_and_total()
        if disk is None or disk[0] >= n_bytes:
            return None
        return f"{self._names.folder}: {disk[0] / BYTES_PER_MB:.1f} MB are left on the disk"

    def enforce_budget(self, in_use: Collection[Path], expected: int = 0) -> None:
        """Removes the oldest logs beyond the budget, and as many as the bytes to come will take."""
        if (budget := self._budget) is not None:
            self._remove_oldest(in_use, lambda held: held + expected - budget)

    def free_bytes(self, n_bytes: int, in_use: Collection[Path]) -> None:
        """Removes the oldest logs until so many bytes are free, where there is a budget at all."""
        disk = self.free_and_total()
        if self._budget is not None and disk is not None and (excess := n_bytes - disk[0]) > 0:
            self._remove_oldest(in_use, lambda held: excess)

    def _remove_oldest(self, in_use: Collection[Path], excess_of: Callable[[int], int]) -> None:
        sizes = {path: _file_size(path) for path in self._names.existing_logs()}
        excess = excess_of(sum(sizes.values()))
        for path, size in sizes.items():
            if excess <= 0:
                return
            if path in in_use:
                continue
            try:
                path.unlink()
            except OSError as error:
                self._report(f"{path}: cannot be removed to make room: {error.strerror}")
                return
            excess -= size
            self.removed += 1
            self._report(f"{path.name}: removed, the oldest log, to make room")


def _file_size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def describe_error(error: Exception) -> str:
    """Why no log can be written, in a few words."""
    return (error.strerror or str(error)).lower() if isinstance(error, OSError) else str(error)
