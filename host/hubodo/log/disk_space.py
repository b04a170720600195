"""Monitor the free disk space of a recording and remove its oldest logs within a budget."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from hubodo.log.log_names import LogNames

BYTES_PER_MB = 1_000_000


@dataclass(frozen=True, slots=True)
class RotationRules:
    """Rules for rotation and disk space.

    Attributes
    ----------
    max_duration, max_size : s and bytes after which the next log begins; None: never.
    budget : bytes for all logs of this name in the folder, beyond which the oldest closed ones are removed;
        None: nothing is ever removed.
    reserve : bytes to keep free on the disk; recording pauses before they are used.
    """

    max_duration: float | None = None
    max_size: int | None = None
    budget: int | None = None
    reserve: int = 0

    @property
    def is_rotating(self) -> bool:
        """True if the recording may consist of several logs."""
        return self.max_duration is not None or self.max_size is not None


class DiskSpace:
    """The disk space of a recording's logs.

    budget: bytes for all logs; None: no log is ever removed. report: called with a line for each log that is
    removed or cannot be removed.
    """

    def __init__(self, names: LogNames, budget: int | None, report: Callable[[str], None]) -> None:
        self.removed = 0
        self._names = names
        self._budget = budget
        self._report = report

    def free_and_total(self) -> tuple[int, int] | None:
        """Return free and total bytes of the disk; None if the folder is missing."""
        try:
            usage = shutil.disk_usage(self._names.folder)
        except OSError:
            return None
        return usage.free, usage.total

    def describe_shortage(self, n_bytes: float) -> str | None:
        """Return None if `n_bytes` are free, else a line with the free space."""
        disk = self.free_and_total()
        if disk is None or disk[0] >= n_bytes:
            return None
        return f"{self._names.folder}: {disk[0] / BYTES_PER_MB:.1f} MB are left on the disk"

    def enforce_budget(self, in_use: Collection[Path], expected: int = 0) -> None:
        """Remove the oldest logs until the total plus the `expected` bytes fits the budget."""
        if (budget := self._budget) is not None:
            self._remove_oldest(in_use, lambda total: total + expected - budget)

    def make_room(self, n_bytes: int, in_use: Collection[Path]) -> None:
        """Remove the oldest logs until `n_bytes` are free; does nothing without a budget."""
        disk = self.free_and_total()
        if self._budget is not None and disk is not None and (excess := n_bytes - disk[0]) > 0:
            self._remove_oldest(in_use, lambda _: excess)

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
    """Return a short reason why no log can be written."""
    return (error.strerror or str(error)).lower() if isinstance(error, OSError) else str(error)
