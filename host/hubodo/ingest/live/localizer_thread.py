"""The localizer in a thread of its own, so that the factor graph does not delay odometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hubodo.fuse.wheel.records import Pose
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.localizer import FixSample, Localizer, MapPose
from hubodo.ingest.live.output_thread import OutputThread
from hubodo.vehicle import Vehicle

MAP_PART = "map"
_MAX_WAITING_ITEMS = 50_000
"""Capacity of the queue: poses and fixes of more than an hour."""
_CLOSE_TIMEOUT_S = 20.0
"""Enough for a minute of queued fixes, even on a small computer."""


@dataclass(frozen=True, slots=True)
class LocalizerOutput:
    """Result for one pose or fix; arrived_ns: arrival time of that item."""

    pose: MapPose | None
    warnings: tuple[str, ...]
    arrived_ns: int


class LocalizerThread:
    """A thread that processes poses and fixes in order and calls `on_output` with each result.

    A graph that fails or hangs is replaced by a new one in the same map frame.
    """

    def __init__(
        self,
        t_zero_ns: int,
        on_output: Callable[[LocalizerOutput], None],
        vehicle: Vehicle | None = None,
        *,
        bulkheads: Bulkheads,
    ) -> None:
        """Start the thread; t_zero_ns, vehicle: as for `Localizer`."""
        self._localizer = Localizer(t_zero_ns, vehicle)
        self._is_new = True
        self._on_output = on_output
        self._thread: OutputThread[tuple[Pose | FixSample, int]] = OutputThread(
            MAP_PART, self._start_handler, bulkheads, capacity=_MAX_WAITING_ITEMS, replaceable=True
        )

    @property
    def waiting_count(self) -> int:
        """Number of queued poses and fixes."""
        return self._thread.waiting_count

    def put(self, item: Pose | FixSample, arrived_ns: int) -> None:
        """Queue a pose or fix with its arrival time."""
        self._thread.put((item, arrived_ns))

    def close(self, timeout_s: float = _CLOSE_TIMEOUT_S) -> bool:
        """Wait up to `timeout_s` for the queued items; return True if all were processed."""
        return self._thread.close(timeout_s, timeout_s)

    def stop(self) -> None:
        """End after the present item; drop the queue."""
        self._thread.stop()

    def _start_handler(self) -> Callable[[tuple[Pose | FixSample, int]], None]:
        """Return the handler of the thread, with a graph that no abandoned thread uses."""
        if not self._is_new:
            self._localizer = self._localizer.successor()
        self._is_new = False
        localizer = self._localizer

        def handle(item: tuple[Pose | FixSample, int]) -> None:
            given, arrived_ns = item
            located = None
            if isinstance(given, FixSample):
                localizer.add_fix(given)
            else:
                located = localizer.add_pose(given)
            warnings = tuple(localizer.warnings())
            if localizer is self._localizer and (located is not None or warnings):
                self._on_output(LocalizerOutput(located, warnings, arrived_ns))

        return handle
