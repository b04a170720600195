"""Serial, TCP and UDP as one thing: bytes in, bytes out, and one error when it is gone."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import termios
from collections.abc import Iterator
from typing import Protocol

import serial

from hubodo.errors import LinkError
from hubodo.ingest.link.ports import Finder, PortName

_READ_BYTES = 65536
_WRITE_S = 0.1
_CONNECT_S = 3.0


class LinkDown(Exception):
    """An open link has gone; str() says how."""


class Transport(Protocol):
    """An open link. `read` and `write` raise LinkDown once it is gone."""

    where: str
    datagrams: bool

    def read(self, timeout: float) -> tuple[bytes, str]:
        """Bytes and who sent them ("" on a line with one sender); no bytes after `timeout` s of silence."""
        ...

    def write(self, data: bytes, to: str) -> None: ...

    def close(self) -> None: ...


@contextlib.contextmanager
def _down(where: str) -> Iterator[None]:
    """The one place where every way in which a port can die becomes LinkDown.

    pyserial lets OSError (EIO from in_waiting), termios.error and TypeError (a port closed under the
    reader) through beside its own SerialException.
    """
    try:
        yield
    except (serial.SerialTimeoutException, BlockingIOError, TimeoutError):
        raise
    except (OSError, termios.error, TypeError, ValueError) as error:
        raise LinkDown(f"{where}: {error}") from error


class SerialTransport:
    """A serial device, opened for us alone.

    DTR and RTS stay as the kernel raises them on open, both set: a USB node takes DTR for "host is
    there", and the two-transistor reset circuit of an ESP32 board acts only when they differ. They are
    not dropped on close either (HUPCL), so that neither open nor close restarts a node.
    """

    datagrams = False

    def __init__(self, path: str, baud: int) -> None:
        """Raises LinkError when the device is missing, busy or not allowed."""
        self.where = path
        try:
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=_WRITE_S, exclusive=True)
        except (OSError, termios.error, ValueError) as error:
            raise _refusal(path, error) from error
        self._fd = self._port.fileno()
        with contextlib.suppress(termios.error):
            flags = termios.tcgetattr(self._fd)
            flags[2] &= ~termios.HUPCL
            termios.tcsetattr(self._fd, termios.TCSANOW, flags)
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._port.set_low_latency_mode(True)

    def read(self, timeout: float) -> tuple[bytes, str]:
        with _down(self.where):
            ready, _, _ = select.select([self._fd], [], [], timeout)
            if not ready:
                return b"", ""
            try:
                data = os.read(self._fd, _READ_BYTES)
            except BlockingIOError:
                return b"", ""
            if not data:
                raise OSError(errno.EIO, "ready to read but no data: unplugged, or read by somebody else too")
            return data, ""

    def write(self, data: bytes, to: str = "") -> None:
        with contextlib.suppress(serial.SerialTimeoutException), _down(self.where):
            self._port.write(data)

    def close(self) -> None:
        with contextlib.suppress(OSError, termios.error, TypeError):
            self._port.close()


class TcpTransport:
    """A byte stream from a socket server, such as a serial-to-network bridge."""

    datagrams = False

    def __init__(self, host: str, port: int) -> None:
        """Raises LinkError when nobody answers there."""
        self.where = f"socket://{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), _CONNECT_S)
        except OSError as error:
            raise LinkError(
                f"{self.where}: {error.strerror or error}; check host and port, and that it listens"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    def read(self, timeout: float) -> tuple[bytes, str]:
        with _down(self.where):
            if not select.select([self._socket], [], [], timeout)[0]:
                return b"", ""
            data = self._socket.recv(_READ_BYTES)
            if not data:
                raise OSError(errno.ECONNRESET, "closed by the other side")
            return data, ""

    def write(self, data: bytes, to: str = "") -> None:
        with contextlib.suppress(TimeoutError), _down(self.where):
            self._socket.settimeout(_WRITE_S)
            self._socket.sendall(data)

    def close(self) -> None:
        self._socket.close()


class UdpTransport:
    """Datagrams from any number of nodes to one port of this machine; each sender is its own stream."""

    datagrams = True

    def __init__(self, host: str, port: int) -> None:
        """Raises LinkError when the address is taken or not ours."""
        self.where = f"udp://{host}:{port}"
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise LinkError(
                f"{self.where}: {error.strerror or error}; give a free port and an address of this machine, "
                "0.0.0.0 for all"
            ) from error

    def read(self, timeout: float) -> tuple[bytes, str]:
        with _down(self.where):
            if not select.select([self._socket], [], [], timeout)[0]:
                return b"", ""
            try:
                data, sender = self._socket.recvfrom(_READ_BYTES)
            except ConnectionRefusedError:
                return b"", ""  # an earlier answer met a closed port: news about a sender, not about us
            return data, f"{sender[0]} {sender[1]}"

    def write(self, data: bytes, to: str) -> None:
        host, _, port = to.rpartition(" ")
        with contextlib.suppress(TimeoutError, ConnectionRefusedError), _down(self.where):
            self._socket.sendto(data, (host, int(port)))

    def close(self) -> None:
        self._socket.close()


def open_transport(port: PortName, finder: Finder, baud: int) -> Transport:
    """Opens what a port name stands for.

    Raises LinkError with the reason and what to do.
    """
    if port.kind == "tcp":
        return TcpTransport(*port.address)
    if port.kind == "udp":
        return UdpTransport(*port.address)
    return SerialTransport(finder.device(), baud)


_ADVICE = {
    errno.ENOENT: ("no such device", "plug it in"),
    errno.EACCES: ("no permission", "join the group dialout, or add a udev rule"),
    errno.EPERM: ("no permission", "join the group dialout, or add a udev rule"),
    errno.EBUSY: ("busy: another program has it", "close that program"),
    errno.EAGAIN: ("busy: another program has it", "close that program"),
    errno.ENOTTY: ("not a serial port", "name a serial device, socket:// or udp://"),
    errno.EISDIR: ("a folder, not a serial port", "name a serial device, socket:// or udp://"),
}


def _refusal(path: str, error: Exception) -> LinkError:
    number = _errno(error)
    if number is None and "lock" in str(error):
        number = errno.EBUSY
    what, remedy = _ADVICE.get(number or 0, (str(error), "check the device"))
    return LinkError(f"{path}: {what}; {remedy}")


def _errno(error: BaseException | None) -> int | None:
    """The system's number behind an error; pyserial wraps some of them into text."""
    while error is not None:
        number = error.args[0] if isinstance(error, OSError | termios.error) and error.args else None
        if isinstance(number, int):
            return number
        error = error.__context__
    return None
