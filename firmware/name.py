"""Resolve the name of the host without blocking, by DNS (RFC 1035) or multicast DNS (RFC 6762)."""

import socket
from time import ticks_diff, ticks_ms

from micropython import const

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_TYPE_A = const(1)
_NAME_SERVER = const(53)
_MULTICAST = ("224.0.0.251", 5353)
"""Group address of multicast DNS, for names that end in .local."""


class Name:
    """Resolves `host` through the network that `wlan` has joined."""

    def __init__(self, wlan, host):
        self._wlan = wlan
        self._host = host
        self._socket: Any = None
        self._query: Any = None

    def address(self):
        """Return the address as text, None while the query is pending: call again every second or so."""
        if is_address(self._host):
            return self._host
        try:
            if self._socket is None:
                self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._socket.setblocking(False)
                self._query = question(self._host, ticks_diff(ticks_ms(), 0) & 0xFFFF)
            address = answer(self._socket.recv(512), self._query)
            if address is not None:
                self.cancel()
                return address
        except OSError:
            # No answer yet.
            pass
        if self._socket is not None:
            self._ask()
        return None

    def cancel(self):
        """Cancel a pending query."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _ask(self):
        try:
            server = _MULTICAST
            if not self._host.endswith(".local"):
                server = (self._wlan.ifconfig()[3], _NAME_SERVER)
            self._socket.sendto(self._query, server)
        except OSError:
            # No network: repeated with the next call.
            pass


def is_address(host):
    """Return True for a dotted IPv4 address."""
    parts = host.split(".")
    return len(parts) == 4 and all(part.isdigit() for part in parts)


def question(host, number):
    """Return a query for the IPv4 address of `host`."""
    query = bytearray((number >> 8, number & 0xFF, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0))
    for label in host.split("."):
        query.append(len(label))
        query.extend(label.encode())
    query.extend(b"\0\0\1\0\1")
    return bytes(query)


def answer(reply, query):
    """Return the first IPv4 address in a reply to that query, None if it is no such reply."""
    try:
        if reply[:2] != query[:2] or not reply[2] & 0x80:
            return None
        at = 12
        for _ in range(reply[5]):
            at = _behind_name(reply, at) + 4
        for _ in range(reply[7]):
            at = _behind_name(reply, at) + 10
            size = reply[at - 2] << 8 | reply[at - 1]
            if reply[at - 9] == _TYPE_A and size == 4 and at + 4 <= len(reply):
                return "%d.%d.%d.%d" % tuple(reply[at : at + 4])
            at += size
    except IndexError:
        pass
    return None


def _behind_name(reply, at):
    while reply[at]:
        if reply[at] >= 0xC0:
            return at + 2
        at += reply[at] + 1
    return at + 1
