"""Standard error as a text stream whose writes time out instead of blocking when nobody reads it."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import TextIO

from hubodo.ingest.readiness import can_write

_READER_TIMEOUT_S = 5.0
_MAX_PIPE_WRITE_BYTES = 512
"""Bytes that a writable pipe accepts without blocking (POSIX: PIPE_BUF is at least 512)."""


class TimeoutStream(io.TextIOBase):
    """An unbuffered text stream to a descriptor that waits up to `timeout_s` for its reader.

    An incomplete line is completed before the next write, so that lines for programs remain complete. Raises
    TimeoutError when nothing is read and OSError when the reader is closed.
    """

    def __init__(
        self, descriptor: int, encoding: str = "utf-8", timeout_s: float = _READER_TIMEOUT_S
    ) -> None:
        self._descriptor = descriptor
        self._encoding = encoding
        self._timeout_s = timeout_s
        self._unwritten = b""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the written bytes."""
        return self._encoding

    def fileno(self) -> int:
        """Return the descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Return True on a terminal."""
        return os.isatty(self._descriptor)

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, text: str) -> int:
        """Write all of `text`."""
        self._drain()
        self._unwritten = text.encode(self._encoding, "replace")
        self._drain()
        return len(text)

    def _drain(self) -> None:
        while self._unwritten:
            if not can_write(self._descriptor, self._timeout_s):
                raise TimeoutError(f"standard error was not read for {self._timeout_s:g} s")
            written = os.write(self._descriptor, self._unwritten[:_MAX_PIPE_WRITE_BYTES])
            self._unwritten = self._unwritten[written:]


def standard_error(timeout_s: float = _READER_TIMEOUT_S) -> TextIO:
    """Return a `TimeoutStream` on standard error, or `sys.stderr` itself where it is not descriptor 2."""
    stream = sys.stderr
    if stream is None:
        return Path(os.devnull).open("w")
    try:
        is_own = stream.fileno() == 2 and os.name == "posix"
    except (OSError, ValueError):
        is_own = False  # replaced, as by a test or a notebook
    if not is_own:
        return stream
    stream.flush()
    return TimeoutStream(2, stream.encoding, timeout_s)  # type: ignore[return-value]
