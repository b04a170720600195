"""Name the logs of a recording and list the existing ones in order."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from hubodo.errors import InputError

_NUMBER_PATTERN, _STAMP_PATTERN, _REPEAT_PATTERN = r"(?:(\d{6,12})-)?", r"(\d{8}T\d{6}Z)", r"(?:-(\d+))?"


class LogNames:
    """Log names with a sequence number and UTC time: `drive-000042-20260401T093000Z.mcap`.

    The number orders the logs, because the clock may be behind that of an earlier recording. It is one more
    than the highest in the folder. Names of earlier versions have no number and sort first.

    out: a folder (names then have no `drive-`), or the path of a single log. plain: name a log `out` itself
    while no such file exists, for recordings without rotation. Raises InputError if it exists.
    """

    def __init__(self, out: Path, *, plain: bool) -> None:
        in_folder = out.is_dir()
        self.folder = out if in_folder else out.parent
        self._stem = "" if in_folder else f"{out.stem}-"
        self._suffix = ".mcap" if in_folder else out.suffix
        self._plain = out if plain and not in_folder else None
        self._pattern = re.compile(
            re.escape(self._stem)
            + _NUMBER_PATTERN
            + _STAMP_PATTERN
            + _REPEAT_PATTERN
            + re.escape(self._suffix)
        )
        if self._plain is not None and out.exists():
            raise InputError(f"{out}: exists already; choose another name, nothing is overwritten")

    def next_path(self, now_ns: int) -> Path:
        """Return an unused path for a log that begins now."""
        if self._plain is not None and not self._plain.exists():
            return self._plain
        stamp = datetime.fromtimestamp(now_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
        newest = max((order[0] for order, _ in self._list_logs()), default=0)
        paths = (self.folder / f"{self._stem}{n:06d}-{stamp}{self._suffix}" for n in count(newest + 1))
        return next(path for path in paths if not path.exists())

    def existing_logs(self) -> list[Path]:
        """Return all logs with such names, oldest first, including those of earlier recordings."""
        return [path for _, path in sorted(self._list_logs())]

    def _list_logs(self) -> list[tuple[tuple[int, str, int], Path]]:
        try:
            paths = list(self.folder.iterdir())
        except OSError:
            return []
        matches = [(self._pattern.fullmatch(path.name), path) for path in paths]
        return [((int(m[1] or 0), m[2], int(m[3] or 1)), path) for m, path in matches if m is not None]
