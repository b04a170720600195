"""The computer that records: its clock, its ports, and what they report until somebody takes it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from hubodo.ingest.link.link import PortLink
from hubodo.ingest.link.ports import DeviceLister, PortName
from hubodo.ingest.live.host_clock import ClockState, clock_state


class Link(Protocol):
    """One port; what it does is told to the computer as `LinkNews`."""

    def open_now(self) -> None:
        """Raises LinkError with the reason, in one line."""
        ...

    def start(self) -> None:
        """Listens from now on; what is not open yet is waited for."""
        ...

    def send(self, data: bytes, to: str = "") -> bool:
        """Whether it went out."""
        ...

    def request_stop(self) -> None:
        """Begins to stop, without waiting."""
        ...

    def stop(self, timeout_s: float = ...) -> None:
        """Closes it; a port that hangs is waited for that long."""
        ...


class Computer(Protocol):
    """All that a recording needs of the world outside."""

    def now_ns(self) -> int:
        """Host time, ns since 1970; it never steps."""
        ...

    def wall_ns(self) -> int:
        """The wall clock, ns since 1970; it steps when somebody sets it."""
        ...

    def clock_state(self) -> ClockState:
        """What is known of the wall clock."""
        ...

    def link(self, port: PortName, label: str, baud: int, lister: DeviceLister) -> Link:
        """A port that is neither open nor started yet."""
        ...

    def put(self, item: Any) -> None:
        """Something to be told by `news`, after all that was put before; from any thread."""
        ...

    def news(self, seconds: float) -> Any:
        """The next thing that was put, waited for up to so many seconds; None when nothing was."""
        ...


class ThisComputer:
    """The one on which this runs; scale: see `steady_clock`."""

    def __init__(self, scale: float = 1.0) -> None:
        self.now_ns = steady_clock(scale)
        # In slowed time there is no wall clock to compare with.
        self.wall_ns = time.time_ns if scale == 1.0 else self.now_ns
        self._news: deque[Any] = deque()
        self._arrived = threading.Event()

    def clock_state(self) -> ClockState:
        """See `Computer`."""
        return clock_state(self.wall_ns())

    def link(self, port: PortName, label: str, baud: int, lister: DeviceLister) -> PortLink:
        """See `Computer`."""
        return PortLink(port, label, self, self.now_ns, baud=baud, lister=lister)

    def put(self, item: Any) -> None:
        """See `Computer`."""
        self._news.append(item)
        self._arrived.set()

    def news(self, seconds: float) -> Any:
        """See `Computer`.

        Not by `SimpleQueue.get`: when a signal comes and its handler outlasts the timeout, CPython 3.11 waits
        there until the next item, which may never come.
        """
        if not self._news and seconds:
            self._arrived.clear()
            if not self._news:
                self._arrived.wait(seconds)
        return self._news.popleft() if self._news else None


def steady_clock(scale: float = 1.0) -> Callable[[], int]:
    """Host time in ns since 1970 that never steps: the wall clock now, and elapsed time from here on.

    Elapsed time counts while the computer is suspended, where the system has such a clock (Linux): nodes go
    on meanwhile. With a scale, it passes that many times slower than the wall clock.
    """
    elapsed_ns = _time_since_boot_ns()
    wall, begin = time.time_ns(), elapsed_ns()
    if scale == 1.0:
        return lambda: wall + elapsed_ns() - begin
    return lambda: wall + int((elapsed_ns() - begin) / scale)


def _time_since_boot_ns() -> Callable[[], int]:
    boot_clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic_ns if boot_clock is None else lambda: time.clock_gettime_ns(boot_clock)
