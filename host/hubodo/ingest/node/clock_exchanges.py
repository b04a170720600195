"""Schedule of the clock requests to one node, and matching of replies to requests."""

from __future__ import annotations

from hubodo.units import NS_PER_S

_BURST_REQUESTS, _BURST_INTERVAL_NS = 8, NS_PER_S // 50
_MAX_OUTSTANDING_REQUESTS = 32


class ClockExchanges:
    """Clock requests to one node: a burst after a start, then one per `period_ns`."""

    def __init__(self, node_id: int, period_ns: int) -> None:
        self._period_ns = period_ns
        # Tokens differ between nodes that receive each other's requests.
        self._number = node_id << 24
        self._sent_ns: dict[bytes, int] = {}
        self._burst_remaining = 0
        self._next_ns = 0

    def start_burst(self) -> None:
        """Start a burst of requests: the node has just started, or the link to it is new."""
        self._burst_remaining, self._next_ns = _BURST_REQUESTS, 0

    def is_due(self, now_ns: int) -> bool:
        """Return True if a request is due; the caller then sends one."""
        if now_ns < self._next_ns:
            return False
        self._burst_remaining -= self._burst_remaining > 0
        self._next_ns = now_ns + (_BURST_INTERVAL_NS if self._burst_remaining else self._period_ns)
        return True

    def next_token(self) -> bytes:
        """Return the token of the next request, without the byte that stops a booting board."""
        self._number += 1
        return bytes(0x20 + (self._number >> shift & 0x0F) for shift in range(0, 32, 4))

    def add_request(self, token: bytes, t_ns: int) -> None:
        """Note that the request with this token was sent at `t_ns`."""
        while len(self._sent_ns) >= _MAX_OUTSTANDING_REQUESTS:
            self._sent_ns.pop(next(iter(self._sent_ns)))
        self._sent_ns[token] = t_ns

    def match_reply(self, token: bytes) -> int | None:
        """Return the time at which the request was sent, ns; None for an unknown token."""
        return self._sent_ns.pop(token, None)

    def clear(self) -> None:
        """Discard all open requests."""
        self._sent_ns.clear()
