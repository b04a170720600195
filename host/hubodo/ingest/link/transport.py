"""Serial, TCP, UDP and Bluetooth links with one interface."""

from __future__ import annotations

import contextlib
import errno
import socket
from collections import Counter

from hubodo.errors import LinkError
from hubodo.ingest.link.ble import BleTransport
from hubodo.ingest.link.keys import KeyRing
from hubodo.ingest.link.open_link import MAX_READ_BYTES, WRITE_TIMEOUT_S, Transport, link_down_on_error
from hubodo.ingest.link.ports import BLE_KIND, DeviceFinder, PortName
from hubodo.ingest.link.sealed import DatagramSealer
from hubodo.ingest.link.serial_port import open_serial
from hubodo.ingest.readiness import can_read

_CONNECT_TIMEOUT_S = 3.0


class TcpTransport:
    """A byte stream from a socket server, such as a serial-to-network bridge."""

    datagrams = False
    refused: Counter[str] = Counter()

    def __init__(self, host: str, port: int) -> None:
        """Connect to the server; raise LinkError when it does not answer."""
        self.endpoint = f"socket://{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), _CONNECT_TIMEOUT_S)
        except (OSError, UnicodeError) as error:
            raise LinkError(
                f"{self.endpoint}: {_error_text(error)}; check host and port, and that the server is running"
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    def read(self, timeout: float) -> tuple[bytes, str]:
        with link_down_on_error(self.endpoint):
            if not can_read(self._socket.fileno(), timeout):
                return b"", ""
            data = self._socket.recv(MAX_READ_BYTES)
            if not data:
                raise OSError(errno.ECONNRESET, "closed by the other side")
            return data, ""

    def write(self, data: bytes, to: str = "") -> None:
        with contextlib.suppress(TimeoutError), link_down_on_error(self.endpoint):
            self._socket.settimeout(WRITE_TIMEOUT_S)
            self._socket.sendall(data)

    def close(self) -> None:
        self._socket.close()


class UdpTransport:
    """A UDP port of this machine that receives from any number of nodes; each sender is a stream."""

    datagrams = True
    refused: Counter[str] = Counter()

    def __init__(self, host: str, port: int) -> None:
        """Bind the address; raise LinkError when it is in use or not of this machine."""
        self.endpoint = f"udp://{host}:{port}"
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            self._socket.bind((host, port))
        except (OSError, UnicodeError) as error:
            self._socket.close()
            raise LinkError(
                f"{self.endpoint}: {_error_text(error)}; give a free port and an address of this machine, "
                "0.0.0.0 for all"
            ) from error

    def read(self, timeout: float) -> tuple[bytes, str]:
        with link_down_on_error(self.endpoint):
            if not can_read(self._socket.fileno(), timeout):
                return b"", ""
            try:
                data, sender = self._socket.recvfrom(MAX_READ_BYTES)
            except (ConnectionRefusedError, BlockingIOError):
                # An earlier answer reached a closed port, or a checksum was wrong: not an error of this port.
                return b"", ""
            return data, f"{sender[0]} {sender[1]}"

    def write(self, data: bytes, to: str) -> None:
        """Send one datagram; an unreachable address is not an error of the port."""
        host, _, port = to.rpartition(" ")
        with contextlib.suppress(OSError):
            self._socket.sendto(data, (host, int(port)))

    def close(self) -> None:
        self._socket.close()


class SealedTransport:
    """A port that passes on authenticated packets only; a sender is the serial of its board."""

    def __init__(self, plain: Transport, keys: KeyRing) -> None:
        self._plain, self._sealer = plain, DatagramSealer(keys)
        self.endpoint, self.datagrams, self.refused = plain.endpoint, plain.datagrams, self._sealer.refused
        self._serial = ""

    def read(self, timeout: float) -> tuple[bytes, str]:
        data, address = self._plain.read(timeout)
        if not data and not address:
            return b"", ""
        opened = self._sealer.open(data, address)
        if opened.answer:
            self._plain.write(opened.answer, address)
        if self.datagrams:
            return opened.frames, opened.serial
        self._serial = opened.serial or self._serial
        return opened.frames, ""

    def write(self, data: bytes, to: str) -> None:
        sealed = self._sealer.seal(data, to if self.datagrams else self._serial)
        if sealed is not None:
            self._plain.write(*sealed)

    def close(self) -> None:
        self._plain.close()


def _error_text(error: OSError | UnicodeError) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def open_transport(port: PortName, finder: DeviceFinder, baud: int) -> Transport:
    """Open the port that a name stands for.

    Raises LinkError with the reason and what to do.
    """
    if port.kind == "tcp":
        return TcpTransport(*port.address)
    plain: Transport
    if port.kind == "udp":
        plain = UdpTransport(*port.address)
    elif port.kind == BLE_KIND:
        plain = BleTransport(port.target)
    else:
        return open_serial(finder.find_device(), baud)
    return plain if port.keys is None else SealedTransport(plain, port.keys)
