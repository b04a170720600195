"""A listening socket with a bounded number of connections, which drops unadmitted connections first.

The rules are those of OpenSSH's MaxStartups and LoginGraceTime, applied when connections are accepted: before
TLS, before the first byte of a request, and for any server on the socket.
"""

from __future__ import annotations

import errno
import socket
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self

from hubodo.listening.descriptors import connection_capacity

ADMISSION_TIMEOUT_S = 10.0
"""A connection not admitted within this time is shut down."""
MAX_ACCEPT_BATCH = 64
"""Maximum number of connections accepted in one iteration of the event loop."""
_KERNEL_BACKLOG = 1024
"""Connections queued in the kernel; beyond, a client repeats its SYN after 1 s."""
_EXHAUSTED_ERRNOS = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)

Peer = tuple[str, int]


@dataclass(frozen=True, slots=True)
class _Connection:
    socket: socket.socket
    accepted_s: float
    """Time of acceptance, s."""


class BoundedListener(socket.socket):
    """A listening socket with at most `capacity` connections; for use in one event loop.

    A connection is pending until `admit` is called with the address of its peer. At capacity, the oldest
    pending connection of the host with most of them is shut down for the new one; if none is pending, the
    new one is closed. `expire` shuts down connections pending for longer than ADMISSION_TIMEOUT_S.
    """

    capacity: int
    _now_s: Callable[[], float]
    _pending: dict[Peer, _Connection]
    _admitted: dict[Peer, _Connection]

    @classmethod
    def listen_on(
        cls, host: str, port: int, *, capacity: int | None = None, clock: Callable[[], float] = time.monotonic
    ) -> Self:
        """Listen on a name or IP number without brackets. Raises OSError or OverflowError."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        plain = socket.create_server((host, port), family=family, backlog=_KERNEL_BACKLOG)
        listener = cls(plain.family, plain.type, plain.proto, plain.detach())
        listener.capacity = connection_capacity() if capacity is None else capacity
        listener._now_s, listener._pending, listener._admitted = clock, {}, {}
        return listener

    def duplicate(self) -> Self:
        """Return a listener on the same socket, with the same connections and a descriptor of its own."""
        copy = type(self)(self.family, self.type, self.proto, socket.dup(self.fileno()))
        copy.capacity, copy._now_s = self.capacity, self._now_s
        copy._pending, copy._admitted = self._pending, self._admitted
        return copy

    def listen(self, backlog: int = _KERNEL_BACKLOG, /) -> None:
        """Listen with the long queue of the kernel: asyncio calls this with the size of its own batches."""
        super().listen(_KERNEL_BACKLOG)

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept the next connection within the capacity, dropping a pending one if necessary."""
        while True:
            connection, address = self._accept_or_shed()
            self._forget_closed()
            peer = (str(address[0]), int(address[1]))
            if len(self._pending) + len(self._admitted) >= self.capacity and not self._shed_oldest():
                connection.close()
                continue
            self._pending[peer] = _Connection(connection, self._now_s())
            return connection, address

    def admit(self, peer: Peer | None) -> None:
        """Admit the connection of a peer whose request may be answered."""
        if peer is not None and (connection := self._pending.pop(peer, None)) is not None:
            self._admitted[peer] = connection

    def expire(self) -> None:
        """Shut down connections pending for too long; to be called about once per second."""
        self._forget_closed()
        latest = self._now_s() - ADMISSION_TIMEOUT_S
        for peer, connection in list(self._pending.items()):
            if connection.accepted_s <= latest:
                self._shut_down(peer)

    def _accept_or_shed(self) -> tuple[socket.socket, Any]:
        try:
            return super().accept()
        except OSError as error:
            # Descriptors are exhausted: a dropped connection frees one in the next iteration of the loop.
            if error.errno in _EXHAUSTED_ERRNOS and self._shed_oldest():
                raise BlockingIOError(errno.EAGAIN, "a pending connection was dropped") from None
            raise

    def _shed_oldest(self) -> bool:
        """Shut down the oldest pending connection of the busiest host; return False if none is pending."""
        if not self._pending:
            return False
        counts = Counter(host for host, _ in self._pending)
        busiest = max(counts.values())
        self._shut_down(next(peer for peer in self._pending if counts[peer[0]] == busiest))
        return True

    def _shut_down(self, peer: Peer) -> None:
        # The event loop still watches the descriptor, reads the end of the stream and closes it.
        with suppress(OSError):
            self._pending.pop(peer).socket.shutdown(socket.SHUT_RDWR)

    def _forget_closed(self) -> None:
        for connections in (self._pending, self._admitted):
            for peer in [peer for peer, one in connections.items() if one.socket.fileno() < 0]:
                del connections[peer]
