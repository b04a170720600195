"""Wait for a descriptor to become readable or writable, also beyond 1,023, where `select` fails."""

from __future__ import annotations

import select


def can_read(descriptor: int, timeout: float) -> bool:
    """Return True once data or the end of the stream can be read; False after `timeout` seconds."""
    if not hasattr(select, "poll"):  # Windows, where select accepts sockets of any number
        return bool(select.select([descriptor], [], [], timeout)[0])
    return _wait_for(descriptor, select.POLLIN | select.POLLPRI, timeout)


def can_write(descriptor: int, timeout: float) -> bool:
    """Return True once a write would not block, or would fail; False after `timeout` seconds."""
    if not hasattr(select, "poll"):
        return bool(select.select([], [descriptor], [], timeout)[1])
    return _wait_for(descriptor, select.POLLOUT, timeout)


def _wait_for(descriptor: int, events: int, timeout: float) -> bool:
    poll = select.poll()
    poll.register(descriptor, events)
    return bool(poll.poll(timeout * 1000.0))
