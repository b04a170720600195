"""The live page as an audience of the recording: frames out ten times a second, requests in."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.snapshot_publisher import Audience
from hubodo.ingest.live.tee_sink import RecordListener
from hubodo.listening.server_thread import ServerFaults
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubodo.web.frames import Frame, event_frame, motion_frame, slow_frame
from hubodo.web.local_plane import local_east_north
from hubodo.web.log_observer import LogObserver

_FRAME_PERIOD_NS = NS_PER_S // 10
_MAX_PENDING_EVENTS = 50
_MAX_PENDING_REQUESTS = 16

RecorderTask = Callable[[Recorder], None]


class LivePage:
    """An `Audience` for the live page.

    Only `submit_task`, `current_log` and `latest_snapshot` may be used from other threads.
    """

    def __init__(
        self, put: Callable[[Frame], None], other: Audience | None = None, server: ServerFaults | None = None
    ) -> None:
        """Start without a log.

        put: called with each frame. other: another audience to serve as well. server: faults of the server.
        """
        self.latest_snapshot: Snapshot | None = None
        self._shown = 0.0  # s, by the monotonic clock
        self.startup_lines: list[str] = []
        """Lines that the recorder prints once for the user."""
        self._put = put
        self._log: LogWriter | None = None
        self._series: LogSeries | None = None
        self._other = other
        self._server = server or ServerFaults()
        self._observer = LogObserver(_MAX_PENDING_EVENTS)
        self._tasks: queue.Queue[RecorderTask] = queue.Queue(_MAX_PENDING_REQUESTS)
        self._start_ns: int | None = None
        self._next_ns = 0
        self._slow: Snapshot | None = None
        self._origin: tuple[float, float] | None = None

    @property
    def current_log(self) -> Path | None:
        """Return the log that is being written, or None."""
        newest = self.latest_snapshot
        return newest.log.path if newest is not None and newest.log.recording else None

    def now_ns(self) -> int:
        """Return the time of the recording's monotonic clock, ns; callable from any thread."""
        newest = self.latest_snapshot
        return 0 if newest is None else newest.t_ns + int((time.monotonic() - self._shown) * NS_PER_S)

    def submit_task(self, task: RecorderTask) -> bool:
        """Queue a task for the thread of the recording; return False if too many are waiting."""
        try:
            self._tasks.put_nowait(task)
        except queue.Full:
            return False
        return True

    def set_recording(self, on: bool) -> bool:
        """Start the next log or end the present one; return False if too many requests are waiting."""
        return self.submit_task(lambda recorder: self._switch(on))

    def _switch(self, on: bool) -> None:
        assert self._log is not None and self._series is not None
        if on:
            self._series.resume()
        else:
            self._log.flush()
            self._series.stop()

    def attach(self, log: LogWriter, series: LogSeries, bulkheads: Bulkheads) -> Mapping[str, RecordListener]:
        """Return the listeners of the log; see `Audience`."""
        self._log, self._series = log, series
        others = {} if self._other is None else self._other.attach(log, series, bulkheads)
        return {"page": self._observer.observe, **others}

    def show(self, snapshot: Snapshot) -> None:
        """Take a snapshot; raise ServerEnded once if the page's server was restarted. See `Audience`."""
        self.latest_snapshot = self._slow = snapshot
        self._shown = time.monotonic()
        self._server.raise_next()

    def poll(self, recorder: Recorder, now_ns: int) -> None:
        """Run queued tasks and send a frame when it is due; see `Audience`."""
        if self._other is not None:
            self._other.poll(recorder, now_ns)
        recorder.notices += [Event(now_ns, "served", "web", line) for line in self.startup_lines]
        self.startup_lines = []
        while not self._tasks.empty():
            self._tasks.get()(recorder)
        if now_ns < self._next_ns:
            return
        start_ns = self._start_ns = now_ns if self._start_ns is None else self._start_ns
        # On a fixed time grid, so that one late frame does not delay the next ones.
        self._next_ns = now_ns - (now_ns - start_ns) % _FRAME_PERIOD_NS + _FRAME_PERIOD_NS
        self._put(self._frame(recorder, (now_ns - start_ns) / NS_PER_S))

    def _frame(self, recorder: Recorder, t: float) -> Frame:
        observer = self._observer
        frame = motion_frame(recorder, t, observer.take_mean_rates())
        if observer.fix is not None:
            frame |= self._fix(recorder, *observer.fix)
            observer.fix = None
        if self._slow is not None:
            frame["s"] = slow_frame(recorder, self._slow)
            self._slow = None
        events = observer.take_events()
        if events:
            wall = time.time()
            frame["e"] = [event_frame(event, wall) for event in events]
        return frame

    def _fix(
        self, recorder: Recorder, latitude_deg: float, longitude_deg: float, sigma: float | None
    ) -> Frame:
        """Return a fix relative to the map origin or to the first fix; a new origin restarts the trail."""
        located = recorder.map.latest
        origin = located.origin_deg if located is not None else self._origin or (latitude_deg, longitude_deg)
        new_origin: Frame = {} if origin == self._origin else {"origin": list(origin)}
        self._origin = origin
        x, y = local_east_north(latitude_deg, longitude_deg, origin)
        rounded_sigma = None if sigma is None else round(sigma, 2)
        return new_origin | {"g": [round(x, 2), round(y, 2), rounded_sigma]}
