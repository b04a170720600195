"""A listening socket with a bounded number of connections: those that prove nothing are shed first.

The rules are those of OpenSSH's MaxStartups and LoginGraceTime, applied where connections are accepted: they
hold before TLS, before the first byte of a request, and for any server that reads from the socket.
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

GRACE_S = 10.0
"""A connection that has not been admitted after this time is shut down."""
ACCEPT_BATCH = 64
"""Most connections that a server accepts in one turn of its loop, and beyond its capacity."""
_KERNEL_QUEUE = 1024
"""Connections that wait in the kernel: a client that finds the queue full repeats its SYN after 1 s."""
_OUT_OF_DESCRIPTORS = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)

Peer = tuple[str, int]


@dataclass(frozen=True, slots=True)
class _Connection:
    socket: socket.socket
    accepted: float
    """s, when it was accepted."""


class BoundedListener(socket.socket):
    """Hold at most `capacity` connections; used on one event loop alone.

    A connection is pending until `admit` is called with the address of its peer. At the capacity, the oldest
    pending connection of the host that has most of them is shut down for the new one; where none is pending,
    the new one is closed. `expire` shuts down the connections that were pending for longer than GRACE_S.
    """

    capacity: int
    _clock: Callable[[], float]
    _pending: dict[Peer, _Connection]
    _admitted: dict[Peer, _Connection]

    @classmethod
    def listen_on(
        cls, host: str, port: int, *, capacity: int | None = None, clock: Callable[[], float] = time.monotonic
    ) -> Self:
        """Listen on a name or IP number without brackets. Raises OSError or OverflowError."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        plain = socket.create_server((host, port), family=family, backlog=_KERNEL_QUEUE)
        listener = cls(plain.family, plain.type, plain.proto, plain.detach())
        listener.capacity = connection_capacity() if capacity is None else capacity
        listener._clock, listener._pending, listener._admitted = clock, {}, {}
        return listener

    def duplicate(self) -> Self:
        """Return a listener on the same socket, with the same connections and a descriptor of its own."""
        twin = type(self)(self.family, self.type, self.proto, socket.dup(self.fileno()))
        twin.capacity, twin._clock = self.capacity, self._clock
        twin._pending, twin._admitted = self._pending, self._admitted
        return twin

    def listen(self, backlog: int = _KERNEL_QUEUE, /) -> None:
        """Listen with the long queue of the kernel: asyncio calls this with the size of its own batches."""
        super().listen(_KERNEL_QUEUE)

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept the next connection for which there is room, or for which a pending one was shed."""
        while True:
            connection, address = self._accept_or_shed()
            self._forget_closed()
            peer = (str(address[0]), int(address[1]))
            if len(self._pending) + len(self._admitted) >= self.capacity and not self._shed():
                connection.close()
                continue
            self._pending[peer] = _Connection(connection, self._clock())
            return connection, address

    def admit(self, peer: Peer | None) -> None:
        """Keep the connection of that peer: it has sent a request that may be answered."""
        if peer is not None and (connection := self._pending.pop(peer, None)) is not None:
            self._admitted[peer] = connection

    def expire(self) -> None:
        """Shut down each connection that has been pending for too long; to be called about once a second."""
        self._forget_closed()
        latest = self._clock() - GRACE_S
        for peer, connection in list(self._pending.items()):
            if connection.accepted <= latest:
                self._shut_down(peer)

    def _accept_or_shed(self) -> tuple[socket.socket, Any]:
        try:
            return super().accept()
        except OSError as error:
            # The descriptors are used up by others: a shed connection gives one back in the loop's next turn.
            if error.errno in _OUT_OF_DESCRIPTORS and self._shed():
                raise BlockingIOError(errno.EAGAIN, "a pending connection was shed") from None
            raise

    def _shed(self) -> bool:
        """Shut down the oldest pending connection of the busiest host; False where none is pending."""
        if not self._pending:
            return False
        counts = Counter(host for host, _ in self._pending)
        busiest = max(counts.values())
        self._shut_down(next(peer for peer in self._pending if counts[peer[0]] == busiest))
        return True

    def _shut_down(self, peer: Peer) -> None:
        # The loop still watches the descriptor: it reads the end of the stream, and closes it.
        with suppress(OSError):
            self._pending.pop(peer).socket.shutdown(socket.SHUT_RDWR)

    def _forget_closed(self) -> None:
        for connections in (self._pending, self._admitted):
            for peer in [peer for peer, one in connections.items() if one.socket.fileno() < 0]:
                del connections[peer]
