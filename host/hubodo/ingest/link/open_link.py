"""What an open link is, and the one error when it is gone."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from typing import Protocol

import serial

try:
    import termios
except ImportError:  # Windows
    TerminalError: type[Exception] = OSError
else:
    TerminalError = termios.error


class LinkDown(Exception):
    """An open link has gone; str() says how."""


class Transport(Protocol):
    """An open link. `read` and `write` raise LinkDown once it is gone."""

    where: str
    datagrams: bool
    refused: Counter[str]
    """Datagrams that were not let in, by cause."""

    def read(self, timeout: float) -> tuple[bytes, str]:
        """Bytes and who sent them ("" on a line with one sender); no bytes after `timeout` s of silence."""
        ...

    def write(self, data: bytes, to: str) -> None: ...

    def close(self) -> None: ...


@contextlib.contextmanager
def link_down_on_error(where: str) -> Iterator[None]:
    """The one place where every way in which a port can die becomes LinkDown.

    pyserial lets OSError (EIO from in_waiting), termios.error and TypeError (a port closed under the
    reader) through beside its own SerialException.
    """
    try:
        yield
    except (serial.SerialTimeoutException, BlockingIOError, TimeoutError):
        raise
    except (OSError, TerminalError, TypeError, ValueError) as error:
        raise LinkDown(f"{where}: {error}") from error
