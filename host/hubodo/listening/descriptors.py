"""The limit of open descriptors of this process: raised at the start, and shared out between its servers."""

from __future__ import annotations

from contextlib import suppress

WANTED = 4096
_MOST_CONNECTIONS = 128
_SHARE = 8
"""A server may hold this fraction of the descriptors: the recording needs the others for ports and logs."""


def raise_descriptor_limit(wanted: int = WANTED) -> None:
    """Raise the soft limit of open descriptors to `wanted`, or to the hard limit where that is lower."""
    try:
        import resource
    except ImportError:  # no such limit on this system
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < limit:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))


def connection_capacity() -> int:
    """Return how many connections one server may hold under the present limit of descriptors."""
    try:
        import resource
    except ImportError:
        return _MOST_CONNECTIONS
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    share = _MOST_CONNECTIONS if soft == resource.RLIM_INFINITY else max(4, soft // _SHARE)
    return min(_MOST_CONNECTIONS, share)
