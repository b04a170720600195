"""What the logs of one recording are called, which files in a folder are such logs, and which go first."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

from hubodo.errors import InputError

_STAMP = r"\d{8}T\d{6}Z(?:-\d+)?"


class LogNames:
    """Names by UTC time, to the second: `drive-20260401T093000Z.mcap`, or without `drive-` in a folder.

    out: a folder, or the file that a single log would be. plain: a log is `out` itself while no such file is
    there, as it is when nothing rotates. Raises InputError where that file exists.
    """

    def __init__(self, out: Path, *, plain: bool) -> None:
        in_folder = out.is_dir()
        self.folder = out if in_folder else out.parent
        self._stem = "" if in_folder else f"{out.stem}-"
        self._suffix = ".mcap" if in_folder else out.suffix
        self._plain = out if plain and not in_folder else None
        self._pattern = re.compile(re.escape(self._stem) + _STAMP + re.escape(self._suffix))
        if self._plain is not None and out.exists():
            raise InputError(f"{out}: exists already; choose another name, nothing is overwritten")

    def fresh(self, now_ns: int) -> Path:
        """A name that no file has, for a log that begins now."""
        if self._plain is not None and not self._plain.exists():
            return self._plain
        stamp = datetime.fromtimestamp(now_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
        for number in range(1, 1000):
            again = f"-{number}" if number > 1 else ""
            path = self.folder / f"{self._stem}{stamp}{again}{self._suffix}"
            if not path.exists():
                return path
        raise InputError(f"{self.folder}: holds a thousand logs of this second; wait for the next one")

    def logs(self) -> list[Path]:
        """All that have such names, oldest first, those of earlier recordings too."""
        try:
            found = [path for path in self.folder.iterdir() if self._pattern.fullmatch(path.name)]
        except OSError:
            return []
        return sorted(found, key=lambda path: (path.name.partition("Z")[0], len(path.name), path.name))
