"""An output of a recording on a thread of its own: what fails or hangs there costs that output alone."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from hubodo.ingest.live.bulkheads import Bulkheads

STALL_S = 5.0
_CHECKS_PER_STALL = 20
_MIN_CHECK_S = STALL_S / _CHECKS_PER_STALL
_IDLE_S = 0.5

T = TypeVar("T")


class OutputStalled(Exception):
    """The output has not returned from the item at hand."""


class OutputThread(Generic[T]):
    """A bounded mailbox in front of a handler; the oldest items are dropped and counted when it is full.

    Parameters
    ----------
    name
        Of the part, in events and metrics.
    make_handler
        Returns what is called with each item; called again after a fault, so that the output restarts.
    bulkheads
        Keeps account of faults; a part that fails or stalls is suspended, its items are dropped meanwhile.
    capacity
        Items that wait at most.
    replaceable
        Whether a stalled thread is abandoned and another one started. Otherwise the output goes on when
        the call at hand returns, as after a terminal that was stopped.
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
        self._changed = threading.Condition()
        self._closing = False
        self._generation = 0
        self._completed = 0
        self._busy = False
        self._seen, self._unchanged, self._next_check = -1, 0, 0.0
        self._thread = self._start()
        bulkheads.watch(self)

    @property
    def waiting(self) -> int:
        """Items that wait."""
        return len(self._items)

    def put(self, item: T) -> None:
        """Hand over an item; returns at once, whatever the output does."""
        with self._changed:
            if self._closing:
                return
            if len(self._items) >= self._capacity:
                self._items.popleft()
                self.dropped += 1
            self._items.append(item)
            self._changed.notify_all()

    def close(self, idle_s: float = _IDLE_S, total_s: float = math.inf) -> bool:
        """End the thread once the mailbox is empty.

        Parameters
        ----------
        idle_s, total_s
            Seconds after which it is given up: without an item completed, and in all.

        Returns
        -------
        bool
            Whether all items were handled. A thread that hangs is abandoned.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
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
        """End the thread after the item at hand; what waits is dropped."""
        with self._changed:
            self._closing = True
            self._items.clear()
            self._changed.notify_all()

    def check_stall(self) -> None:
        """Report an item that takes longer than `STALL_S`, once; called by the watchdog of the bulkheads."""
        now = time.monotonic()
        if now < self._next_check:
            return
        self._next_check = now + _MIN_CHECK_S
        self._unchanged = self._unchanged + 1 if self._busy and self._completed == self._seen else 0
        self._seen = self._completed
        if self._unchanged == _CHECKS_PER_STALL:
            what = "another thread takes its place" if self._replaceable else "cut off until it does"
            self._bulkheads.record(self.name, OutputStalled(f"no return within {STALL_S:g} s; {what}"))
            if self._replaceable:
                self._abandon()
                self._thread = self._start()

    def _start(self) -> threading.Thread:
        thread = threading.Thread(target=self._work, args=(self._generation,), daemon=True, name=self.name)
        thread.start()
        return thread

    def _abandon(self) -> None:
        with self._changed:
            self._generation += 1
            self._busy = False

    def _work(self, generation: int) -> None:
        handler: Callable[[T], object] | None = None
        for item in self._taken(generation):
            try:
                if self._bulkheads.is_suspended(self.name):
                    self.dropped += 1
                    continue
                handler = handler or self._make_handler()
                handler(item)
                self._bulkheads.succeeded(self.name)
            except BaseException as error:  # noqa: BLE001 rich raises SystemExit when its reader is gone
                handler = None
                if generation == self._generation:
                    self._bulkheads.record(self.name, error)
            finally:
                if generation == self._generation:
                    self._completed += 1
                    self._busy = False

    def _taken(self, generation: int) -> Iterator[T]:
        """Yield items as they come, until this thread has nothing more to do."""
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: bool(self._items) or self._closing or generation != self._generation
                )
                if not self._items or generation != self._generation:
                    return
                item = self._items.popleft()
                self._busy = True
            yield item
