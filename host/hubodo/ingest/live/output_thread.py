"""A thread for one output of a recording, so that its faults and hangs affect no other part."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from hubodo.ingest.live.bulkheads import Bulkheads

STALL_TIMEOUT_S = 5.0
_CHECKS_PER_STALL = 20
_MIN_CHECK_S = STALL_TIMEOUT_S / _CHECKS_PER_STALL
_CLOSE_IDLE_S = 0.5

T = TypeVar("T")


class OutputStalled(Exception):
    """Raised for an output whose handler does not return."""


class OutputThread(Generic[T]):
    """A bounded queue in front of a handler; when it is full, the oldest items are dropped and counted.

    Parameters
    ----------
    name
        Name of the part in events and metrics.
    make_handler
        Returns the function called with each item; called again after a fault, which restarts the output.
    bulkheads
        Counts faults; while a part is suspended after a fault or stall, its items are dropped.
    capacity
        Maximum number of queued items.
    replaceable
        True if a stalled thread is abandoned and replaced. Otherwise the output continues when the present
        call returns, as after a stopped terminal.
    """

    def __init__(
        self,
        name: str,
        make_handler: Callable[[], Callable[[T], object]],
        bulkheads: Bulkheads,
        *,
        capacity: int = 1024,
        replaceable: bool = False,
    ) -> None:
        self.name = name
        self.dropped = 0
        self._make_handler = make_handler
        self._bulkheads = bulkheads
        self._items: deque[T] = deque()
        self._capacity = capacity
        self._replaceable = replaceable
        self._condition = threading.Condition()
        self._is_closing = False
        self._generation = 0
        self._completed = 0
        self._is_busy = False
        self._last_completed, self._unchanged, self._next_check = -1, 0, 0.0
        self._thread = self._start()
        bulkheads.watch_output(self)

    @property
    def waiting_count(self) -> int:
        """Number of queued items."""
        return len(self._items)

    def put(self, item: T) -> None:
        """Queue an item without blocking."""
        with self._condition:
            if self._is_closing:
                return
            if len(self._items) >= self._capacity:
                self._items.popleft()
                self.dropped += 1
            self._items.append(item)
            self._condition.notify_all()

    def close(self, idle_s: float = _CLOSE_IDLE_S, total_s: float = math.inf) -> bool:
        """End the thread once the queue is empty.

        Parameters
        ----------
        idle_s, total_s
            Time limits: without a completed item, and in total.

        Returns
        -------
        bool
            True if all items were handled. A thread that hangs is abandoned.
        """
        with self._condition:
            self._is_closing = True
            self._condition.notify_all()
        end = time.monotonic() + total_s
        completed, idle_end = -1, 0.0
        while self._thread.is_alive():
            now = time.monotonic()
            if self._completed != completed:
                completed, idle_end = self._completed, now + idle_s
            if now > min(idle_end, end):
                self._abandon()
                return False
            self._thread.join(0.02)
        return True

    def stop(self) -> None:
        """End the thread after the present item; drop the queue."""
        with self._condition:
            self._is_closing = True
            self._items.clear()
            self._condition.notify_all()

    def check_stall(self) -> None:
        """Report an item that takes longer than `STALL_TIMEOUT_S`, once; called by the watchdog."""
        now = time.monotonic()
        if now < self._next_check:
            return
        self._next_check = now + _MIN_CHECK_S
        self._unchanged = (
            self._unchanged + 1 if self._is_busy and self._completed == self._last_completed else 0
        )
        self._last_completed = self._completed
        if self._unchanged == _CHECKS_PER_STALL:
            consequence = "replaced by a new thread" if self._replaceable else "no output until it does"
            self._bulkheads.record_fault(
                self.name, OutputStalled(f"no return within {STALL_TIMEOUT_S:g} s; {consequence}")
            )
            if self._replaceable:
                self._abandon()
                self._thread = self._start()

    def _start(self) -> threading.Thread:
        thread = threading.Thread(target=self._work, args=(self._generation,), daemon=True, name=self.name)
        thread.start()
        return thread

    def _abandon(self) -> None:
        with self._condition:
            self._generation += 1
            self._is_busy = False

    def _work(self, generation: int) -> None:
        handler: Callable[[T], object] | None = None
        for item in self._next_items(generation):
            try:
                if self._bulkheads.is_suspended(self.name):
                    self.dropped += 1
                    continue
                handler = handler or self._make_handler()
                handler(item)
                self._bulkheads.end_suspension(self.name)
            except BaseException as error:  # noqa: BLE001 rich raises SystemExit when its pipe is closed
                handler = None
                if generation == self._generation:
                    self._bulkheads.record_fault(self.name, error)
            finally:
                if generation == self._generation:
                    self._completed += 1
                    self._is_busy = False

    def _next_items(self, generation: int) -> Iterator[T]:
        """Yield items until this thread is closed or replaced."""
        while True:
            with self._condition:
                self._condition.wait_for(
                    lambda: bool(self._items) or self._is_closing or generation != self._generation
                )
                if not self._items or generation != self._generation:
                    return
                item = self._items.popleft()
                self._is_busy = True
            yield item
