"""The recording computer: its clocks, its links and the queue of their reports."""

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
    """One port, which adds a `LinkReport` to the computer's queue for all that happens to it."""

    def open_now(self) -> None:
        """Open the port; raise LinkError with a one-line reason."""
        ...

    def start(self) -> None:
        """Start reading; a port that is not open yet is waited for."""
        ...

    def send(self, data: bytes, to: str = "") -> bool:
        """Send bytes to the peer `to`; return True on success."""
        ...

    def request_stop(self) -> None:
        """Request the end of reading, without waiting."""
        ...

    def stop(self, timeout_s: float = ...) -> None:
        """Close the port; wait up to `timeout_s` for one that blocks."""
        ...


class Computer(Protocol):
    """Clocks, links and report queue of a recording computer, real or virtual."""

    def now_ns(self) -> int:
        """Return host time, ns since 1970; it never steps."""
        ...

    def wall_ns(self) -> int:
        """Return the wall clock, ns since 1970; it steps when it is set."""
        ...

    def clock_state(self) -> ClockState:
        """Return the synchronisation state of the wall clock."""
        ...

    def create_link(self, port: PortName, label: str, baud: int, lister: DeviceLister) -> Link:
        """Return a link on a port, not opened or started."""
        ...

    def put(self, item: Any) -> None:
        """Append an item to the queue of `next_report`; from any thread."""
        ...

    def next_report(self, timeout_s: float) -> Any:
        """Return the next item, waiting up to `timeout_s` for it; None if there was none."""
        ...


class ThisComputer:
    """The computer on which this process runs; scale: slowdown of its clock, see `steady_clock`."""

    def __init__(self, scale: float = 1.0) -> None:
        self.now_ns = steady_clock(scale)
        # With slowed time there is no wall clock to compare with.
        self.wall_ns = time.time_ns if scale == 1.0 else self.now_ns
        self._reports: deque[Any] = deque()
        self._arrived = threading.Event()

    def clock_state(self) -> ClockState:
        """Return the synchronisation state of the wall clock."""
        return clock_state(self.wall_ns())

    def create_link(self, port: PortName, label: str, baud: int, lister: DeviceLister) -> PortLink:
        """Return a link on a port, not opened or started."""
        return PortLink(port, label, self, self.now_ns, baud=baud, lister=lister)

    def put(self, item: Any) -> None:
        """Append an item to the queue of `next_report`; from any thread."""
        self._reports.append(item)
        self._arrived.set()

    def next_report(self, timeout_s: float) -> Any:
        """Return the next item, waiting up to `timeout_s` for it; None if there was none.

        `SimpleQueue.get` is not used: if a signal handler runs longer than the timeout, CPython 3.11 waits
        there until the next item, which may never arrive.
        """
        if not self._reports and timeout_s:
            self._arrived.clear()
            if not self._reports:
                self._arrived.wait(timeout_s)
        return self._reports.popleft() if self._reports else None


def steady_clock(scale: float = 1.0) -> Callable[[], int]:
    """Return a host clock, ns since 1970, that never steps: the present wall clock plus elapsed time.

    On Linux elapsed time includes suspension of the computer, during which nodes continue. With a scale the
    clock runs that many times slower than the wall clock.
    """
    elapsed_ns = _time_since_boot_ns()
    wall_ns, start_ns = time.time_ns(), elapsed_ns()
    if scale == 1.0:
        return lambda: wall_ns + elapsed_ns() - start_ns
    return lambda: wall_ns + int((elapsed_ns() - start_ns) / scale)


def _time_since_boot_ns() -> Callable[[], int]:
    boot_clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic_ns if boot_clock is None else lambda: time.clock_gettime_ns(boot_clock)
