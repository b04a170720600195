"""The limit of open descriptors of this process, and its share for each server."""

from __future__ import annotations

from contextlib import suppress

WANTED_DESCRIPTORS = 4096
_MAX_CONNECTIONS = 128
_DESCRIPTOR_DIVISOR = 8
"""A server may use 1/8 of the descriptors; the recording needs the others for ports and logs."""


def raise_descriptor_limit(minimum: int = WANTED_DESCRIPTORS) -> None:
    """Raise the soft limit of open descriptors to `minimum`, or to the hard limit if that is lower."""
    try:
        import resource
    except ImportError:  # no such limit on this system
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = minimum if hard == resource.RLIM_INFINITY else min(minimum, hard)
    if soft != resource.RLIM_INFINITY and soft < limit:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))


def connection_capacity() -> int:
    """Return the maximum number of connections of one server under the present descriptor limit."""
    try:
        import resource
    except ImportError:
        return _MAX_CONNECTIONS
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    share = _MAX_CONNECTIONS if soft == resource.RLIM_INFINITY else max(4, soft // _DESCRIPTOR_DIVISOR)
    return min(_MAX_CONNECTIONS, share)
