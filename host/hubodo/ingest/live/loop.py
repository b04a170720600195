"""The loop of a recording: news to the recorder, ticks to what waits for the clock, and an end in time."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from hubodo.errors import CalibrationError, InputError, WireMismatch
from hubodo.ingest.link.link import LinkReport
from hubodo.ingest.live.bulkheads import PartHung
from hubodo.ingest.live.computer import Computer, Link
from hubodo.ingest.live.host_clock import HostClock
from hubodo.ingest.live.localizer_thread import Answer, LocalizerThread
from hubodo.ingest.live.notify import Notifier
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import Watched
from hubodo.ingest.live.view import View
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.units import NS_PER_S

_TICK_NS = NS_PER_S // 50
_BATCH = 256
_DECODE_S = 0.6
"""How long what waits at the end is still decoded; together with ports, graph and disk two seconds."""
_FAR_NS, _NEAR_NS = 10 * NS_PER_S, NS_PER_S
"""What has waited so long is not decoded, which bounds the backlog, until what comes is near again."""
_JOIN_S = 0.4
_GRAPH_S = 0.3
_UNREAD = "frames go into the log raw and are not decoded until that is made up; hubodo import decodes them"

Verdict = InputError | WireMismatch | CalibrationError | None


class _Backlog:
    """News to the recorder: decoded while it keeps up, else raw into the log until it has."""

    def __init__(self, recorder: Recorder) -> None:
        self.now_ns = 0
        self._recorder = recorder
        self._behind = False

    def take(self, item: LinkReport | Answer) -> None:
        """The next of them."""
        late_ns = 0 if isinstance(item, Answer) else self.now_ns - item.t_ns
        if late_ns > (_NEAR_NS if self._behind else _FAR_NS):
            if not self._behind:
                self._recorder.warn("recorder", f"{late_ns / NS_PER_S:.0f} s behind; {_UNREAD}")
            self._behind = True
            self._recorder.keep(item)
            return
        if self._behind:
            self._behind = False
            self._recorder.warn("recorder", "kept up again; frames are decoded")
        self._recorder.handle(item)


@dataclass(frozen=True, eq=False)
class Loop:
    """One recording. stopping: a wish to end it; again: for a new log. clock: s, of the end alone."""

    links: Mapping[str, Link]
    computer: Computer
    recorder: Recorder
    localizer: LocalizerThread | None
    log: LogWriter
    series: LogSeries
    view: View
    watched: Watched
    stopping: threading.Event
    again: threading.Event
    notifier: Notifier = field(default_factory=Notifier)
    clock: Callable[[], float] = time.monotonic

    def run(self, duration: float | None, *, judged: bool) -> tuple[Verdict, float]:
        """From the start of the links to the last thing that came: why it ended, and how long it took, s.

        duration: s, None until `stopping`. judged: whether the recorder's verdict ends it.
        """
        self.watched.add("service manager", self.notifier.show)
        for link in self.links.values():
            link.start()
        start_ns = self.computer.now_ns()
        self.notifier.ready()
        with _short_collections(), self.recorder.bulkheads.watching_for_hangs():
            verdict = self._turn_until_the_end(duration, judged)
            took = self._end(start_ns)
        self.log.close()
        self.say()
        return verdict, took

    def _turn_until_the_end(self, duration: float | None, judged: bool) -> Verdict:
        end_ns = None if duration is None else self.computer.now_ns() + int(duration * NS_PER_S)
        next_tick = 0
        backlog, host_clock = _Backlog(self.recorder), HostClock(self.computer)
        while not self.stopping.is_set():
            wait = _TICK_NS / NS_PER_S
            for _ in range(_BATCH):
                item = self.computer.news(wait)
                if item is None:
                    break
                self._guarded(backlog.take, item)
                wait = 0.0
            backlog.now_ns = now = self.computer.now_ns()
            if now < next_tick:
                continue
            next_tick = now + _TICK_NS
            self.recorder.bulkheads.run("clock", self._check_clock, host_clock, now)
            self._guarded(self._tick, now)
            verdict = self.recorder.verdict() if judged else None
            if verdict is not None or (end_ns is not None and now >= end_ns):
                return verdict
        return None

    def _check_clock(self, host_clock: HostClock, now_ns: int) -> None:
        for event in host_clock.tick(now_ns):
            self.recorder.host_clock(event, host_clock.record)

    def _guarded(self, action: Callable[[Any], None], argument: object) -> None:
        """Call `action`; an interruption that met a part just as it returned ends this call alone."""
        try:
            action(argument)
        except PartHung as error:
            self.recorder.bulkheads.record("recorder", error, pausing=False)

    def _tick(self, now_ns: int) -> None:
        self.notifier.alive()
        self.recorder.tick(now_ns)
        if self.again.is_set():
            self.again.clear()
            self.log.flush()
            self.series.rotate()
        self.log.tick()
        self.series.tick(now_ns)
        if self.series.has_new_log():
            self.recorder.tell_again()
            self.log.repeat_static_frames(now_ns)
        self.say()
        self.watched.tick(now_ns)

    def say(self) -> None:
        """What the recorder and its logs have to tell the user."""
        for notice in self.series.notices:
            if self.series.closed:
                self.view.say(notice)
            else:
                self.recorder.warn("log", notice)
        self.series.notices.clear()
        for event in self.recorder.notices:
            self.view.say(event)
        self.recorder.notices.clear()

    def _end(self, start_ns: int) -> float:
        self.notifier.stopping()
        hurry = self.stopping.is_set()
        run = self.recorder.bulkheads.run
        for label, link in self.links.items():
            run(f"link {label}", link.request_stop)
        join_until = self.clock() + _JOIN_S
        for label, link in self.links.items():
            run(f"link {label}", link.stop, max(join_until - self.clock(), 0.0))
        self._handle_rest(hurry)
        duration = (self.computer.now_ns() - start_ns) / NS_PER_S
        self.recorder.close()
        if self.localizer is not None and not (
            self.localizer.close(_GRAPH_S) if hurry else self.localizer.close()
        ):
            self.view.say(
                "the graph was too slow to come to its end; the last seconds of map → odom are missing"
            )
        self._handle_rest(hurry)
        return duration

    def _handle_rest(self, hurry: bool) -> None:
        """What waits: decoded, or kept raw when the time for that is over."""
        until = self.clock() + _DECODE_S
        while (item := self.computer.news(0.0)) is not None:
            if hurry and self.clock() > until:
                self.recorder.keep(item)
            else:
                self.recorder.handle(item)


def stop(links: Mapping[str, Link]) -> None:
    """Gives the ports back, however far they have come."""
    for link in links.values():
        link.request_stop()
    for link in links.values():
        link.stop()


@contextmanager
def _short_collections() -> Iterator[None]:
    """Keeps what is loaded by now out of garbage collection, which else stops the loop for 10 ms and more.

    What a program that records had taken out of it itself stays out of it afterwards.
    """
    already = gc.get_freeze_count()
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        if not already:
            gc.unfreeze()
