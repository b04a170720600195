"""The main loop of a recording: reports to the recorder, periodic ticks, and a timely shutdown."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from hubodo.errors import CalibrationError, InputError, WireMismatch
from hubodo.ingest.live.bulkheads import PartHung
from hubodo.ingest.live.computer import Computer, Link
from hubodo.ingest.live.host_clock import HostClock
from hubodo.ingest.live.localizer_thread import LocalizerOutput, LocalizerThread
from hubodo.ingest.live.notify import ServiceNotifier
from hubodo.ingest.live.recorder import Recorder, RecorderInput
from hubodo.ingest.live.snapshot_publisher import SnapshotPublisher
from hubodo.ingest.live.view import View
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.units import NS_PER_S

_TICK_INTERVAL_NS = NS_PER_S // 50
_MAX_REPORTS_PER_TURN = 256
_FINAL_DECODE_S = 0.6
"""Time limit for decoding the queue at the end; with ports, graph and disk two seconds in total."""
_MAX_DECODE_LAG_NS, _RESUME_DECODE_LAG_NS = 10 * NS_PER_S, NS_PER_S
"""Bytes that waited longer than the first are logged without decoding, which bounds the backlog, until the
wait falls below the second."""
_LINK_JOIN_S = 0.4
_GRAPH_TIMEOUT_S = 0.3
_RAW_ONLY_TEXT = "frames are logged raw, not decoded, until it has caught up; hubodo import decodes them"

FatalError = InputError | WireMismatch | CalibrationError | None


class _Backlog:
    """Passes reports to the recorder for decoding; while it is too late, they are only logged raw."""

    def __init__(self, recorder: Recorder) -> None:
        self.now_ns = 0
        self._recorder = recorder
        self._is_behind = False

    def handle(self, item: RecorderInput) -> None:
        """Handle the next report."""
        lag_ns = 0 if isinstance(item, LocalizerOutput) else self.now_ns - item.t_ns
        if lag_ns > (_RESUME_DECODE_LAG_NS if self._is_behind else _MAX_DECODE_LAG_NS):
            if not self._is_behind:
                self._recorder.warn("recorder", f"{lag_ns / NS_PER_S:.0f} s behind; {_RAW_ONLY_TEXT}")
            self._is_behind = True
            self._recorder.log_undecoded(item)
            return
        if self._is_behind:
            self._is_behind = False
            self._recorder.warn("recorder", "caught up; frames are decoded again")
        self._recorder.handle(item)


@dataclass(frozen=True, eq=False)
class Loop:
    """The main loop of one recording.

    stop_requested ends the recording and rotate_requested starts a new log. clock: monotonic time, s, for
    the time limits of the shutdown.
    """

    links: Mapping[str, Link]
    computer: Computer
    recorder: Recorder
    localizer: LocalizerThread | None
    log: LogWriter
    series: LogSeries
    view: View
    publisher: SnapshotPublisher
    stop_requested: threading.Event
    rotate_requested: threading.Event
    notifier: ServiceNotifier = field(default_factory=ServiceNotifier)
    clock: Callable[[], float] = time.monotonic

    def run(self, duration: float | None, *, check_fatal: bool) -> tuple[FatalError, float]:
        """Record until the end; return the fatal error, if any, and the duration, s.

        duration: s, None until `stop_requested`. check_fatal: True if a fatal error of the recorder ends it.
        """
        self.publisher.add_observer("service manager", self.notifier.show)
        for link in self.links.values():
            link.start()
        start_ns = self.computer.now_ns()
        self.notifier.notify_ready()
        with _freeze_garbage_collection(), self.recorder.bulkheads.watch_for_hangs():
            verdict = self._run_until_stopped(duration, check_fatal)
            duration_s = self._shut_down(start_ns)
        self.log.close()
        self.show_notices()
        return verdict, duration_s

    def _run_until_stopped(self, duration: float | None, check_fatal: bool) -> FatalError:
        end_ns = None if duration is None else self.computer.now_ns() + int(duration * NS_PER_S)
        next_tick = 0
        backlog, host_clock = _Backlog(self.recorder), HostClock(self.computer)
        while not self.stop_requested.is_set():
            wait = _TICK_INTERVAL_NS / NS_PER_S
            for _ in range(_MAX_REPORTS_PER_TURN):
                item = self.computer.next_report(wait)
                if item is None:
                    break
                self._call_guarded(backlog.handle, item)
                wait = 0.0
            backlog.now_ns = now = self.computer.now_ns()
            if now < next_tick:
                continue
            next_tick = now + _TICK_INTERVAL_NS
            self.recorder.bulkheads.run("clock", self._check_clock, host_clock, now)
            self._call_guarded(self._tick, now)
            verdict = self.recorder.fatal_error() if check_fatal else None
            if verdict is not None or (end_ns is not None and now >= end_ns):
                return verdict
        return None

    def _check_clock(self, host_clock: HostClock, now_ns: int) -> None:
        for event in host_clock.tick(now_ns):
            self.recorder.handle_clock_event(event, host_clock.metadata)

    def _call_guarded(self, action: Callable[[Any], None], argument: object) -> None:
        """Call `action`; a `PartHung` that arrives just after its part has returned ends only this call."""
        try:
            action(argument)
        except PartHung as error:
            self.recorder.bulkheads.record_fault("recorder", error, pausing=False)

    def _tick(self, now_ns: int) -> None:
        self.notifier.feed_watchdog()
        self.recorder.tick(now_ns)
        if self.rotate_requested.is_set():
            self.rotate_requested.clear()
            self.log.flush()
            self.series.rotate()
        self.log.tick()
        self.series.tick(now_ns)
        if self.series.has_new_log():
            self.recorder.repeat_state()
            self.log.repeat_static_frames(now_ns)
        self.show_notices()
        self.publisher.tick(now_ns)

    def show_notices(self) -> None:
        """Show the notices of the recorder and its logs to the user."""
        for notice in self.series.notices:
            if self.series.closed:
                self.view.show_notice(notice)
            else:
                self.recorder.warn("log", notice)
        self.series.notices.clear()
        for event in self.recorder.notices:
            self.view.show_notice(event)
        self.recorder.notices.clear()

    def _shut_down(self, start_ns: int) -> float:
        self.notifier.notify_stopping()
        is_stopped = self.stop_requested.is_set()
        run = self.recorder.bulkheads.run
        for label, link in self.links.items():
            run(f"link {label}", link.request_stop)
        join_until = self.clock() + _LINK_JOIN_S
        for label, link in self.links.items():
            run(f"link {label}", link.stop, max(join_until - self.clock(), 0.0))
        self._handle_remaining(is_stopped)
        duration = (self.computer.now_ns() - start_ns) / NS_PER_S
        self.recorder.close()
        if self.localizer is not None and not (
            self.localizer.close(_GRAPH_TIMEOUT_S) if is_stopped else self.localizer.close()
        ):
            self.view.show_notice(
                "the factor graph did not finish in time; the last seconds of map → odom are missing"
            )
        self._handle_remaining(is_stopped)
        return duration

    def _handle_remaining(self, is_stopped: bool) -> None:
        """Decode the queued reports; log them raw once the time limit is exceeded."""
        until = self.clock() + _FINAL_DECODE_S
        while (item := self.computer.next_report(0.0)) is not None:
            if is_stopped and self.clock() > until:
                self.recorder.log_undecoded(item)
            else:
                self.recorder.handle(item)


def stop_links(links: Mapping[str, Link]) -> None:
    """Stop all links and release their ports."""
    for link in links.values():
        link.request_stop()
    for link in links.values():
        link.stop()


@contextmanager
def _freeze_garbage_collection() -> Iterator[None]:
    """Exclude the objects loaded so far from garbage collection, which otherwise takes 10 ms or more.

    Objects that the calling program had excluded itself stay excluded afterwards.
    """
    already = gc.get_freeze_count()
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        if not already:
            gc.unfreeze()
