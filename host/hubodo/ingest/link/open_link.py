"""The interface of an open link and the error raised once it is closed or unplugged."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator
from typing import Protocol

import serial

MAX_READ_BYTES = 65536
WRITE_TIMEOUT_S = 0.1

try:
    import termios
except ImportError:  # Windows
    TerminalError: type[Exception] = OSError
else:
    TerminalError = termios.error


class LinkDown(Exception):
    """Raised when an open link is closed, unplugged or reset; the text gives the cause."""


class Transport(Protocol):
    """An open link; `read` and `write` raise LinkDown once it is lost.

    Attributes
    ----------
    endpoint
        Name of the device or address that is open.
    datagrams
        True where each read returns one datagram of one of several senders.
    refused
        Number of datagrams that were not accepted, by cause.
    """

    endpoint: str
    datagrams: bool
    refused: Counter[str]

    def read(self, timeout: float) -> tuple[bytes, str]:
        """Return bytes and their sender ("" on a line with one sender); no bytes after `timeout` seconds."""
        ...

    def write(self, data: bytes, to: str) -> None:
        """Send bytes; `to`: the sender they are addressed to, as `read` returned it."""
        ...

    def close(self) -> None:
        """Release the port."""
        ...


@contextlib.contextmanager
def link_down_on_error(endpoint: str) -> Iterator[None]:
    """Raise LinkDown for every exception by which a port reports that it is lost.

    Besides its own SerialException, pyserial raises OSError (EIO from in_waiting), termios.error, and
    TypeError when another thread closes the port during a read.
    """
    try:
        yield
    except (serial.SerialTimeoutException, BlockingIOError, TimeoutError):
        raise
    except (OSError, TerminalError, TypeError, ValueError) as error:
        raise LinkDown(f"{endpoint}: {error}") from error
