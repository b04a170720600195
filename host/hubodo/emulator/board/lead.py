"""A board led from outside: how far it may live, a call that is too early for that, and what it has sent."""

from __future__ import annotations

from collections.abc import Callable

from hubodo.emulator.board.clock import BoardClock
from hubodo.emulator.board.link import HostLink
from hubodo.emulator.board.processor import Request


class Lead:
    """Of one board; with any clock but a led one it lets everything pass."""

    def __init__(self, clock: BoardClock, link: HostLink) -> None:
        self._clock, self._link = clock, link
        self.on_lived: Callable[[], None] = lambda: None
        """Called once the board has lived as far as it may, again and again."""
        self._early: Request | None = None
        self._written: list[tuple[int, int]] = []
        self._counted = 0

    def live_until(self, t: float, heard: int) -> None:
        """The board may live until t, ns, and has the next so many bytes of its host."""
        self._link.await_bytes(heard)
        self._clock.limit = t

    def forget(self) -> None:
        """The interpreter that called has ended."""
        self._early = None

    def next_call(self, take: Callable[[], Request | None]) -> Request | None:
        """The next call, once the clock may go so far; take: gives the one that has come, if one has."""
        request = self._early or take()
        self._early = request if request is not None and request.t > self._clock.limit else None
        return None if self._early else request

    def look(self, *, waits: bool) -> None:
        """Whether the board has lived so far; waits: for its link, within a call."""
        limit = self._clock.limit
        if self._clock.t >= limit if waits else self._early is not None and self._early.t > limit:
            self.on_lived()

    def note_written(self) -> None:
        """To be called whenever the link may have taken something."""
        count = self._link.counts["written"]
        if self._clock.led and count != self._counted:
            self._written.append((round(self._clock.t), count - self._counted))
            self._counted = count

    def take_written(self) -> list[tuple[int, int]]:
        """(ns, bytes) of what the link has taken since the last call."""
        written, self._written = self._written, []
        return written
