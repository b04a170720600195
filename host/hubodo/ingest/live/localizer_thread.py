"""The localizer on a thread of its own: odometry is published before the graph has seen it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hubodo.fuse.wheel.records import Pose
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.localizer import Antenna, FixSample, Localizer, Located
from hubodo.ingest.live.output_thread import OutputThread

PART = "map"
_CAPACITY = 50_000
"""Poses and fixes that wait: more than an hour of them."""
_PATIENCE_S = 20.0
"""s; a minute of fixes that waited is through by then, even on a small computer."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What an item led to; arrived_ns: of the item."""

    located: Located | None
    warnings: tuple[str, ...]
    arrived_ns: int


class LocalizerThread:
    """Takes poses and fixes in their order and calls `answer` with what becomes of them, on its thread.

    A graph that fails or hangs is replaced by a new one in the same map frame.
    """

    def __init__(
        self,
        t_zero_ns: int,
        answer: Callable[[Answer], None],
        antenna: Antenna | None = None,
        *,
        bulkheads: Bulkheads,
    ) -> None:
        """t_zero_ns, antenna: as for `Localizer`."""
        self._localizer = Localizer(t_zero_ns, antenna)
        self._is_new = True
        self._answer = answer
        self._thread: OutputThread[tuple[Pose | FixSample, int]] = OutputThread(
            PART, self._start, bulkheads, capacity=_CAPACITY, replaceable=True
        )

    @property
    def waiting(self) -> int:
        """Poses and fixes that wait."""
        return self._thread.waiting

    def put(self, item: Pose | FixSample, arrived_ns: int) -> None:
        """Hand over the next pose or fix and the time at which it was known."""
        self._thread.put((item, arrived_ns))

    def close(self, patience_s: float = _PATIENCE_S) -> bool:
        """Wait up to `patience_s` seconds for the answers to all that was put; return whether they came."""
        return self._thread.close(patience_s, patience_s)

    def stop(self) -> None:
        """End after the item at hand; what else was put is dropped."""
        self._thread.stop()

    def _start(self) -> Callable[[tuple[Pose | FixSample, int]], None]:
        """Return the handler of the thread: of a graph of its own, which no abandoned thread touches."""
        if not self._is_new:
            self._localizer = self._localizer.successor()
        self._is_new = False
        localizer = self._localizer

        def handle(item: tuple[Pose | FixSample, int]) -> None:
            given, arrived_ns = item
            located = None
            if isinstance(given, FixSample):
                localizer.fix(given)
            else:
                located = localizer.odometry(given)
            warnings = tuple(localizer.warnings())
            if localizer is self._localizer and (located is not None or warnings):
                self._answer(Answer(located, warnings, arrived_ns))

        return handle
