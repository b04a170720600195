"""Room for logs: what is left on their disk, and the oldest of them removed where a budget says so."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection
from pathlib import Path

from hubodo.log.log_names import LogNames

MB = 1_000_000


class Room:
    """Of the disk on which a recording's logs are. budget: bytes for all of them, None: none is ever removed.

    say: gets a line for each that is removed, or cannot be.
    """

    def __init__(self, names: LogNames, budget: int | None, say: Callable[[str], None]) -> None:
        self.removed = 0
        self._names = names
        self._budget = budget
        self._say = say

    def disk(self) -> tuple[int, int] | None:
        """Bytes free and in all; None where the folder is not there."""
        try:
            usage = shutil.disk_usage(self._names.folder)
        except OSError:
            return None
        return usage.free, usage.total

    def lacks(self, wanted: float) -> str | None:
        """Where less than that many bytes are free: how much is, in words."""
        disk = self.disk()
        if disk is None or disk[0] >= wanted:
            return None
        return f"{self._names.folder}: {disk[0] / MB:.1f} MB are left on the disk"

    def keep_to_budget(self, in_use: Collection[Path], coming: int = 0) -> None:
        """Removes the oldest logs beyond the budget, and as many as the bytes to come will take."""
        if (budget := self._budget) is not None:
            self._remove(in_use, lambda held: held + coming - budget)

    def make(self, wanted: int, in_use: Collection[Path]) -> None:
        """Removes the oldest logs until so many bytes are free, where there is a budget at all."""
        disk = self.disk()
        if self._budget is not None and disk is not None and (excess := wanted - disk[0]) > 0:
            self._remove(in_use, lambda held: excess)

    def _remove(self, in_use: Collection[Path], excess_of: Callable[[int], int]) -> None:
        sizes = {path: _size(path) for path in self._names.logs()}
        excess = excess_of(sum(sizes.values()))
        for path, size in sizes.items():
            if excess <= 0:
                return
            if path in in_use:
                continue
            try:
                path.unlink()
            except OSError as error:
                self._say(f"{path}: cannot be removed to make room: {error.strerror}")
                return
            excess -= size
            self.removed += 1
            self._say(f"{path.name}: removed, the oldest log, to make room")


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def words_of(error: Exception) -> str:
    """Why no log can be written, in a few words."""
    return (error.strerror or str(error)).lower() if isinstance(error, OSError) else str(error)
