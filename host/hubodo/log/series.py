"""One recording over several files, each a whole log on its own, begun anew by size or by time."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from hubodo.errors import InputError
from hubodo.log.writer import McapLog

Setup = Callable[[McapLog], None]


class LogSeries:
    """Gives the log to write to: `series.log.imu(...)`, and `series.tick()` ten times a second.

    path: `drive.mcap` makes `drive-0000.mcap`, `drive-0001.mcap`, ... None may exist (InputError).
    max_bytes, max_s: a new file begins when the present one is this big or old; None: no bound. metadata:
    text by key, in every file. setup: called with each new log, for what every file should hold besides
    (attachments). options: further arguments of `McapLog`. All files share one `t_zero_ns`.
    """

    def __init__(
        self,
        path: Path,
        *,
        max_bytes: int | None = None,
        max_s: float | None = None,
        metadata: Mapping[str, str] | None = None,
        setup: Setup | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
        **options: Any,
    ) -> None:
        taken = re.compile(rf"{re.escape(path.stem)}-\d{{4,}}{re.escape(path.suffix)}")
        if path.parent.is_dir() and any(taken.fullmatch(other.name) for other in path.parent.iterdir()):
            raise InputError(
                f"{path.with_name(f'{path.stem}-0000{path.suffix}')}: this series exists already; "
                "choose another name, nothing is overwritten"
            )
        self._path, self._max_bytes, self._clock = path, max_bytes, clock
        self._max_ns = None if max_s is None else int(max_s * 1e9)
        self._metadata, self._setup, self._options = dict(metadata or {}), setup, options
        self.paths: list[Path] = []
        """The files so far, the one being written last."""
        self.log = self._begin()

    def _begin(self) -> McapLog:
        number = len(self.paths)
        path = self._path.with_name(f"{self._path.stem}-{number:04d}{self._path.suffix}")
        metadata = {**self._metadata, "series.number": str(number)}
        log = McapLog(path, metadata=metadata, clock=self._clock, **self._options)
        # The first file fixes t = 0 for all.
        self._options["t_zero_ns"] = log.t_zero_ns
        self.paths.append(path)
        self._began = self._clock()
        if self._setup is not None:
            self._setup(log)
        return log

    def tick(self) -> None:
        """Write what waited long enough; begin a new file when it is time: `log` is then another one."""
        self.log.tick()
        full = self._max_bytes is not None and self.log.size >= self._max_bytes
        old = self._max_ns is not None and self._clock() - self._began >= self._max_ns
        if (full or old) and self.log.message_count:
            self.rotate()

    def rotate(self) -> None:
        """Begin a new file now; it is open before the present one is closed, so a failure loses nothing."""
        before, self.log = self.log, self._begin()
        before.close()

    def close(self) -> None:
        """Close the file being written. Idempotent."""
        self.log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
