"""Lockstep control of a board: its time limit, a call beyond it, and the output up to it."""

from __future__ import annotations

from collections.abc import Callable

from hubodo.emulator.board.clock import BoardClock
from hubodo.emulator.board.link import HostLink
from hubodo.emulator.board.processor import Request


class LockstepControl:
    """Lockstep control of one board; with any other clock it has no effect."""

    def __init__(self, clock: BoardClock, link: HostLink) -> None:
        self._clock, self._link = clock, link
        self.on_limit_reached: Callable[[], None] = lambda: None
        """Called repeatedly while the board is at its limit."""
        self._early_call: Request | None = None
        self._output: list[tuple[int, int]] = []
        self._recorded_bytes = 0

    def allow_until(self, t: float, host_bytes: int) -> None:
        """Let the board run until t, ns, with the next `host_bytes` bytes of its host."""
        self._link.await_bytes(host_bytes)
        self._clock.limit = t

    def discard_call(self) -> None:
        """Discard the call of an interpreter that has ended."""
        self._early_call = None

    def next_call(self, receive: Callable[[], Request | None]) -> Request | None:
        """Return the next call once the time limit allows it; receive: returns a received call or None."""
        request = self._early_call or receive()
        self._early_call = request if request is not None and request.t > self._clock.limit else None
        return None if self._early_call else request

    def check_limit(self, *, in_call: bool) -> None:
        """Call `on_limit_reached` if the board has reached its limit.

        in_call: during a call that waits for its link.
        """
        limit = self._clock.limit
        if self._clock.t >= limit if in_call else self._early_call is not None and self._early_call.t > limit:
            self.on_limit_reached()

    def record_output(self) -> None:
        """Record new output; to be called whenever the link may have accepted bytes."""
        count = self._link.counts["written"]
        if self._clock.lockstep and count != self._recorded_bytes:
            self._output.append((round(self._clock.t), count - self._recorded_bytes))
            self._recorded_bytes = count

    def pop_output(self) -> list[tuple[int, int]]:
        """Return (ns, bytes) of the output since the last call."""
        written, self._output = self._output, []
        return written
