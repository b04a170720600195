"""The localizer on a thread of its own: odometry is published before the graph has seen it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass

from hubodo.fuse.wheel.records import Pose
from hubodo.ingest.live.localizer import Antenna, FixSample, Localizer, Located

_PATIENCE_S = 20.0
"""s; a minute of fixes that waited is through by then, even on a small computer."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What an item led to; arrived_ns: of the item."""

    located: Located | None
    warnings: tuple[str, ...]
    arrived_ns: int


class LocalizerThread:
    """Give it poses and fixes in their order; `answer` is called with what becomes of them, on its thread."""

    def __init__(
        self, t_zero_ns: int, answer: Callable[[Answer], None], antenna: Antenna | None = None
    ) -> None:
        """As for `Localizer`."""
        self._localizer = Localizer(t_zero_ns, antenna)
        self._items: queue.SimpleQueue[tuple[Pose | FixSample, int] | None] = queue.SimpleQueue()
        self._answer = answer
        self._stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True, name="localizer")
        self._thread.start()

    def put(self, item: Pose | FixSample, arrived_ns: int) -> None:
        """The next pose or fix, and when it was known; let go once the thread has ended."""
        if not self._stopped:
            self._items.put((item, arrived_ns))

    def close(self, patience_s: float = _PATIENCE_S) -> bool:
        """Waits for the answers to all that was put; False when they did not come in time."""
        self._items.put(None)
        self._thread.join(patience_s)
        done = not self._thread.is_alive()
        self.stop()
        return done

    def stop(self) -> None:
        """Ends it after the item at hand, whatever else was put."""
        self._stopped = True
        self._items.put(None)

    def _run(self) -> None:
        through = False
        try:
            self._work()
            through = True
        finally:
            self._stopped = True
            if not through:
                text = "the graph failed; map → odom ends here, all else goes on"
                self._answer(Answer(None, (text,), 0))

    def _work(self) -> None:
        while (given := self._items.get()) is not None and not self._stopped:
            item, arrived_ns = given
            located = None
            if isinstance(item, FixSample):
                self._localizer.fix(item)
            else:
                located = self._localizer.odometry(item)
            warnings = tuple(self._localizer.warnings())
            if located is not None or warnings:
                self._answer(Answer(located, warnings, arrived_ns))
