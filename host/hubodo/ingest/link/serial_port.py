"""Serial ports: direct reads on Linux and macOS, reads by pyserial on other systems."""

from __future__ import annotations

import contextlib
import errno
import os
from collections import Counter
from collections.abc import Callable

import serial

from hubodo.errors import LinkError
from hubodo.ingest.link.open_link import (
    MAX_READ_BYTES,
    WRITE_TIMEOUT_S,
    TerminalError,
    Transport,
    link_down_on_error,
)
from hubodo.ingest.readiness import can_read

try:
    import termios
except ImportError:  # Windows
    termios = None  # type: ignore[assignment]


def open_serial(path: str, baud: int, *, portable: bool = termios is None) -> Transport:
    """Open a serial device exclusively; portable: read by pyserial, which also accepts its URLs.

    Raises LinkError when the device is missing, busy or not permitted.
    """
    return PortableSerial(path, baud) if portable else SerialTransport(path, baud)


class _SerialBase:
    """Base class of serial ports: opening, writing and closing."""

    datagrams = False
    refused: Counter[str] = Counter()

    def __init__(self, open_port: Callable[..., serial.Serial], endpoint: str, baud: int) -> None:
        self.endpoint = endpoint
        try:
            self._port = open_port(endpoint, baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        except (OSError, TerminalError, ValueError) as error:
            raise _open_error(endpoint, error) from error

    def write(self, data: bytes, to: str = "") -> None:
        with contextlib.suppress(serial.SerialTimeoutException), link_down_on_error(self.endpoint):
            self._port.write(data)

    def close(self) -> None:
        with contextlib.suppress(OSError, TerminalError, TypeError):
            self._port.close()


class SerialTransport(_SerialBase):
    """A serial device, opened exclusively.

    DTR and RTS stay set as the kernel raises them on open: a USB node interprets DTR as "host is
    connected", and the two-transistor reset circuit of an ESP32 board acts only when they differ. They are
    not dropped on close either (HUPCL), so that neither open nor close restarts a node.
    """

    def __init__(self, path: str, baud: int) -> None:
        """Open the device; raise LinkError when it is missing, busy or not permitted."""
        super().__init__(serial.Serial, path, baud)
        self._fd = self._port.fileno()
        with contextlib.suppress(TerminalError):
            flags = termios.tcgetattr(self._fd)
            flags[2] &= ~termios.HUPCL
            termios.tcsetattr(self._fd, termios.TCSANOW, flags)
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._port.set_low_latency_mode(True)

    def read(self, timeout: float) -> tuple[bytes, str]:
        with link_down_on_error(self.endpoint):
            if not can_read(self._fd, timeout):
                return b"", ""
            try:
                data = os.read(self._fd, MAX_READ_BYTES)
            except BlockingIOError:
                return b"", ""
            if not data:
                raise OSError(
                    errno.EIO, "ready to read but no data: unplugged, or read by another program too"
                )
            return data, ""


class PortableSerial(_SerialBase):
    """A serial device read by pyserial, blocking for the first byte: for systems without termios."""

    def __init__(self, url: str, baud: int) -> None:
        """Open the device; raise LinkError when it is missing, busy or not permitted."""
        super().__init__(serial.serial_for_url, url, baud)

    def read(self, timeout: float) -> tuple[bytes, str]:
        with link_down_on_error(self.endpoint):
            if self._port.timeout != timeout:
                self._port.timeout = timeout  # reconfigures the port, so not on each read
            data = self._port.read(1)
            if data and (more := self._port.in_waiting):
                data += self._port.read(min(more, MAX_READ_BYTES))
            return bytes(data), ""


_ADVICE = {
    errno.ENOENT: ("no such device", "plug it in"),
    errno.EACCES: ("no permission", "join the group dialout, or add a udev rule"),
    errno.EPERM: ("no permission", "join the group dialout, or add a udev rule"),
    errno.EBUSY: ("busy: another program has opened it", "close that program"),
    errno.EAGAIN: ("busy: another program has opened it", "close that program"),
    errno.ENOTTY: ("not a serial port", "name a serial device, socket:// or udp://"),
    errno.EISDIR: ("a folder, not a serial port", "name a serial device, socket:// or udp://"),
}


_PYSERIAL_PHRASES = {
    "lock": errno.EBUSY,
    "FileNotFoundError": errno.ENOENT,
    "PermissionError": errno.EBUSY,
    "not recognised": errno.ENOENT,
}
"""Phrases in errors of pyserial without an errno: its lock, and refusals by Windows."""


def _open_error(path: str, error: Exception) -> LinkError:
    number = _find_errno(error)
    if number is None:
        number = next((number for phrase, number in _PYSERIAL_PHRASES.items() if phrase in str(error)), None)
    what, remedy = _ADVICE.get(number or 0, (str(error), "check the device"))
    return LinkError(f"{path}: {what}; {remedy}")


def _find_errno(error: BaseException | None) -> int | None:
    """Return the errno behind an error, following its causes; pyserial wraps some into text."""
    while error is not None:
        number = error.args[0] if isinstance(error, OSError | TerminalError) and error.args else None
        if isinstance(number, int):
            return number
        error = error.__context__
    return None
