"""Whether a descriptor can be read or written, for descriptors of any number: `select` ends at 1,023."""

from __future__ import annotations

import select


def can_read(descriptor: int, timeout: float) -> bool:
    """Return True once there is something to read, or the end of it, within `timeout` seconds."""
    if not hasattr(select, "poll"):  # Windows, where select takes sockets of any number
        return bool(select.select([descriptor], [], [], timeout)[0])
    return _poll(descriptor, select.POLLIN | select.POLLPRI, timeout)


def can_write(descriptor: int, timeout: float) -> bool:
    """Return True once a write would not block, or would fail, within `timeout` seconds."""
    if not hasattr(select, "poll"):
        return bool(select.select([], [descriptor], [], timeout)[1])
    return _poll(descriptor, select.POLLOUT, timeout)


def _poll(descriptor: int, events: int, timeout: float) -> bool:
    poll = select.poll()
    poll.register(descriptor, events)
    return bool(poll.poll(timeout * 1000.0))
