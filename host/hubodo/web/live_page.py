"""The page as the recording sees it: ten times a second it is told something, and its wishes are done."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import Audience, Snapshot
from hubodo.ingest.live.tee_sink import RecordListener
from hubodo.listening.server_thread import ServerFaults
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubodo.web.frames import Frame, east_north, event_frame, motion_frame, slow_frame
from hubodo.web.watch import Ear

_PERIOD_NS = NS_PER_S // 10
_MOST_EVENTS = 50
_MOST_WISHES = 16

Wish = Callable[[Recorder], None]


class LivePage:
    """An `Audience`; all but `wish`, `file` and `newest` is for the thread of the recording."""

    def __init__(
        self, put: Callable[[Frame], None], other: Audience | None = None, server: ServerFaults | None = None
    ) -> None:
        """put: gets each frame. other: who else watches. server: errors that ended the page's server."""
        self.newest: Snapshot | None = None
        self._shown = 0.0  # s, by the monotonic clock
        self.greetings: list[str] = []
        """Lines for the user of the recorder, told once."""
        self._put = put
        self._log: LogWriter | None = None
        self._series: LogSeries | None = None
        self._other = other
        self._server = server or ServerFaults()
        self._ear = Ear(_MOST_EVENTS)
        self._wishes: queue.Queue[Wish] = queue.Queue(_MOST_WISHES)
        self._begin_ns: int | None = None
        self._next_ns = 0
        self._slow: Snapshot | None = None
        self._origin: tuple[float, float] | None = None

    @property
    def file(self) -> Path | None:
        """The log that is being written."""
        newest = self.newest
        return newest.log.path if newest is not None and newest.log.recording else None

    def now_ns(self) -> int:
        """Return the time of the recording's own clock, which is never set; from any thread."""
        newest = self.newest
        return 0 if newest is None else newest.t_ns + int((time.monotonic() - self._shown) * NS_PER_S)

    def wish(self, wish: Wish) -> bool:
        """Something to be done in the recording's own thread; False when too much waits already."""
        try:
            self._wishes.put_nowait(wish)
        except queue.Full:
            return False
        return True

    def record(self, on: bool) -> bool:
        """Begins the next log, or ends this one; False when too much waits already."""
        return self.wish(lambda recorder: self._switch(on))

    def _switch(self, on: bool) -> None:
        assert self._log is not None and self._series is not None
        if on:
            self._series.resume()
        else:
            self._log.flush()
            self._series.stop()

    def attach(self, log: LogWriter, series: LogSeries, bulkheads: Bulkheads) -> Mapping[str, RecordListener]:
        """See `Audience`."""
        self._log, self._series = log, series
        others = {} if self._other is None else self._other.attach(log, series, bulkheads)
        return {"page": self._ear.hear, **others}

    def show(self, snapshot: Snapshot) -> None:
        """See `Audience`. Raises ServerEnded, once, where the page's server had to be restarted."""
        self.newest = self._slow = snapshot
        self._shown = time.monotonic()
        self._server.raise_next()

    def poll(self, recorder: Recorder, now_ns: int) -> None:
        """See `Audience`."""
        if self._other is not None:
            self._other.poll(recorder, now_ns)
        recorder.notices += [Event(now_ns, "served", "web", line) for line in self.greetings]
        self.greetings = []
        while not self._wishes.empty():
            self._wishes.get()(recorder)
        if now_ns < self._next_ns:
            return
        begin_ns = self._begin_ns = now_ns if self._begin_ns is None else self._begin_ns
        # On a beat of its own: what is late once is not late for ever.
        self._next_ns = now_ns - (now_ns - begin_ns) % _PERIOD_NS + _PERIOD_NS
        self._put(self._frame(recorder, (now_ns - begin_ns) / NS_PER_S))

    def _frame(self, recorder: Recorder, t: float) -> Frame:
        ear = self._ear
        frame = motion_frame(recorder, t, ear.spins())
        if ear.fix is not None:
            frame |= self._fix(recorder, *ear.fix)
            ear.fix = None
        if self._slow is not None:
            frame["s"] = slow_frame(recorder, self._slow)
            self._slow = None
        events = ear.take_events()
        if events:
            wall = time.time()
            frame["e"] = [event_frame(event, wall) for event in events]
        return frame

    def _fix(
        self, recorder: Recorder, latitude_deg: float, longitude_deg: float, sigma: float | None
    ) -> Frame:
        """A fix on the map, or around the first fix; a new origin takes the old fixes away."""
        located = recorder.map.latest
        origin = located.origin_deg if located is not None else self._origin or (latitude_deg, longitude_deg)
        fresh: Frame = {} if origin == self._origin else {"origin": list(origin)}
        self._origin = origin
        x, y = east_north(latitude_deg, longitude_deg, origin)
        across = None if sigma is None else round(sigma, 2)
        return fresh | {"g": [round(x, 2), round(y, 2), across]}
