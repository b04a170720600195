"""Standard error as a text stream whose write fails instead of blocking for good when nobody reads it."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import TextIO

from hubodo.ingest.readiness import can_write

_PATIENCE_S = 5.0
_PIECE = 512
"""Bytes that a pipe takes without blocking once it is writable (POSIX: PIPE_BUF is at least 512)."""


class PatientStream(io.TextIOBase):
    """Writes to a descriptor unbuffered, waiting up to `patience_s` seconds for its reader.

    A line that was cut off is completed first when writing goes on, so that lines for programs stay whole.
    Raises TimeoutError when nothing is read and OSError when the reader is gone.
    """

    def __init__(self, descriptor: int, encoding: str = "utf-8", patience_s: float = _PATIENCE_S) -> None:
        self._descriptor = descriptor
        self._encoding = encoding
        self._patience_s = patience_s
        self._rest = b""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Of the bytes that are written."""
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
        self._rest = text.encode(self._encoding, "replace")
        self._drain()
        return len(text)

    def _drain(self) -> None:
        while self._rest:
            if not can_write(self._descriptor, self._patience_s):
                raise TimeoutError(f"nobody has read standard error for {self._patience_s:g} s")
            written = os.write(self._descriptor, self._rest[:_PIECE])
            self._rest = self._rest[written:]


def standard_error(patience_s: float = _PATIENCE_S) -> TextIO:
    """Return a `PatientStream` on standard error, or `sys.stderr` itself where it is not descriptor 2."""
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
    return PatientStream(2, stream.encoding, patience_s)  # type: ignore[return-value]
