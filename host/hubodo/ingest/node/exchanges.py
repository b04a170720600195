"""The questions for one node's clock: when to ask, and which answer belongs to which."""

from __future__ import annotations

from hubodo.units import NS_PER_S

_BURST, _BURST_NS = 8, NS_PER_S // 50
_OUTSTANDING = 32


class Exchanges:
    """Many questions at a start, then one each `period_ns`."""

    def __init__(self, node_id: int, period_ns: int) -> None:
        self._period_ns = period_ns
        # Tokens differ between nodes that hear each other's questions.
        self._number = node_id << 24
        self._asked: dict[bytes, int] = {}
        self._burst_left = 0
        self._next_ns = 0

    def burst(self) -> None:
        """The node has just started, or the link to it is new."""
        self._burst_left, self._next_ns = _BURST, 0

    def due(self, now_ns: int) -> bool:
        """Whether it is time for a question; to be followed by one."""
        if now_ns < self._next_ns:
            return False
        self._burst_left -= self._burst_left > 0
        self._next_ns = now_ns + (_BURST_NS if self._burst_left else self._period_ns)
        return True

    def token(self) -> bytes:
        """Of the next question: without a byte that stops a board that boots."""
        self._number += 1
        return bytes(0x20 + (self._number >> shift & 0x0F) for shift in range(0, 32, 4))

    def asked(self, token: bytes, t_ns: int) -> None:
        """A question was sent at t_ns."""
        while len(self._asked) >= _OUTSTANDING:
            self._asked.pop(next(iter(self._asked)))
        self._asked[token] = t_ns

    def answered(self, token: bytes) -> int | None:
        """When the question was sent; None for an answer to nobody's."""
        return self._asked.pop(token, None)

    def forget(self) -> None:
        """The node that was asked has restarted."""
        self._asked.clear()
