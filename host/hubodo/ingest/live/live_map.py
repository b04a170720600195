"""The vehicle's place on the map during a recording: to the localizer and back, and into the log."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hubodo.fuse.wheel.records import Pose
from hubodo.ingest.live.latency import Latency
from hubodo.ingest.live.localizer import FixSample, Located
from hubodo.ingest.live.localizer_thread import Answer, LocalizerThread
from hubodo.ingest.sink import Sink
from hubodo.recording import Event


class LiveMap:
    """Passes odometry and fixes on to a localizer, and writes its answers; without one it does nothing.

    located: the newest answer, None before one. poses: how many there were.
    """

    def __init__(
        self, localizer: LocalizerThread | None, sink: Sink, now_ns: Callable[[], int], notices: list[Event]
    ) -> None:
        """notices: gets what the user should hear of."""
        self.located: Located | None = None
        self.poses = 0
        self.latency = Latency()
        self._localizer = localizer
        self._sink = sink
        self._now_ns = now_ns
        self._notices = notices
        self._origin: Event | None = None

    @property
    def is_active(self) -> bool:
        """Return True if odometry and fixes go to a localizer."""
        return self._localizer is not None

    def put(self, items: Iterable[Pose | FixSample], arrived_ns: int) -> None:
        """Pass poses and fixes on, in the order in which a log gives them again."""
        if self._localizer is not None:
            for item in items:
                self._localizer.put(item, arrived_ns)

    def handle(self, answer: Answer) -> None:
        """Write an answer of the localizer."""
        now_ns = self._now_ns()
        for line in answer.warnings:
            self._notices.append(Event(now_ns, "warning", "map", f"map: {line}"))
            self._sink.write_event(Event(now_ns, "warning", "map", line))
        located = answer.located
        if located is None:
            return
        if self._origin is None:
            latitude, longitude = located.origin_deg
            text = (
                f"map: origin at latitude {latitude:.7f}, longitude {longitude:.7f} degrees; x east, y north"
            )
            data = {"latitude_deg": latitude, "longitude_deg": longitude}
            self._origin = Event(int(located.t_ns[0]), "started", "map", text, data)
            self._sink.write_event(self._origin)
        self.located = located
        self.poses += 1
        located.write(self._sink, now_ns)
        self.latency.add(self._now_ns() - answer.arrived_ns)

    def repeat_origin(self, now_ns: int) -> None:
        """Write the origin of the map into a log that has just begun."""
        if self._origin is not None:
            self._sink.write_event(self._origin, now_ns)
