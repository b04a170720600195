"""Map position during a recording: odometry and fixes to the localizer, its poses to the log."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hubodo.fuse.wheel.records import Pose
from hubodo.ingest.live.latency import LatencyHistogram
from hubodo.ingest.live.localizer import FixSample, MapPose
from hubodo.ingest.live.localizer_thread import LocalizerOutput, LocalizerThread
from hubodo.log.records import EventRecord, Sink
from hubodo.recording import Event


class LiveMap:
    """Connection to a localizer that forwards odometry and fixes and logs the poses; inactive without one.

    latest: newest pose on the map, None before the first. pose_count: number of poses.
    """

    def __init__(
        self, localizer: LocalizerThread | None, sink: Sink, now_ns: Callable[[], int], notices: list[Event]
    ) -> None:
        """Start without a pose; notices: list to which events for the user are added."""
        self.latest: MapPose | None = None
        self.pose_count = 0
        self.latency = LatencyHistogram()
        self._localizer = localizer
        self._sink = sink
        self._now_ns = now_ns
        self._notices = notices
        self._origin: Event | None = None

    @property
    def is_active(self) -> bool:
        """True if there is a localizer."""
        return self._localizer is not None

    def put(self, items: Iterable[Pose | FixSample], arrived_ns: int) -> None:
        """Forward poses and fixes in the order in which playback of the log returns them."""
        if self._localizer is not None:
            for item in items:
                self._localizer.put(item, arrived_ns)

    def handle(self, answer: LocalizerOutput) -> None:
        """Log an output of the localizer."""
        now_ns = self._now_ns()
        for line in answer.warnings:
            self._notices.append(Event(now_ns, "warning", "map", f"map: {line}"))
            self._sink.write_record(EventRecord(Event(now_ns, "warning", "map", line)))
        located = answer.pose
        if located is None:
            return
        if self._origin is None:
            latitude, longitude = located.origin_deg
            text = (
                f"map: origin at latitude {latitude:.7f}, longitude {longitude:.7f} degrees; x east, y north"
            )
            data = {"latitude_deg": latitude, "longitude_deg": longitude}
            self._origin = Event(int(located.t_ns[0]), "started", "map", text, data)
            self._sink.write_record(EventRecord(self._origin))
        self.latest = located
        self.pose_count += 1
        located.write(self._sink, now_ns)
        self.latency.add(self._now_ns() - answer.arrived_ns)

    def repeat_origin(self, now_ns: int) -> None:
        """Write the origin of the map into a new log."""
        if self._origin is not None:
            self._sink.write_record(EventRecord(self._origin, now_ns))
