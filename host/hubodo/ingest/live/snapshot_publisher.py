"""Publication of a snapshot of a recording once per second to its observers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import LogStatus, Snapshot
from hubodo.ingest.live.take_snapshot import take_snapshot
from hubodo.ingest.live.tee_sink import RecordListener
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.recording import Event
from hubodo.units import NS_PER_S

SnapshotObserver = Callable[[Snapshot], Iterable[Event] | None]
"""Called with each snapshot in the recorder's thread; must return at once. Returned events are logged."""


class Audience(Protocol):
    """An observer with access to the recorder; called in the recorder's thread, so it must not block."""

    def attach(self, log: LogWriter, series: LogSeries, bulkheads: Bulkheads) -> Mapping[str, RecordListener]:
        """Return the listeners to all log records, by name of their part; called once before the start."""
        ...

    def poll(self, recorder: Recorder, now_ns: int) -> None:
        """Inspect the recorder; called about fifty times per second."""
        ...

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot; called once per second."""
        ...


class SnapshotPublisher:
    """Publishes a snapshot of the recorder once per second to observers, each behind its bulkhead."""

    def __init__(
        self,
        recorder: Recorder,
        log: Callable[[], LogStatus],
        watch: Mapping[str, SnapshotObserver],
        audience: Audience | None = None,
    ) -> None:
        """Start with these observers, by name of their part."""
        self._recorder, self._log, self._audience = recorder, log, audience
        self._observers = dict(watch)
        if audience is not None:
            self._observers["page"] = audience.show
        self._started_ns = self._next_ns = 0

    def add_observer(self, part: str, observer: SnapshotObserver) -> None:
        """Add an observer."""
        self._observers[part] = observer

    def tick(self, now_ns: int) -> None:
        """Publish a snapshot if one is due; the first call marks the start."""
        run = self._recorder.bulkheads.run
        if self._audience is not None:
            run("page", self._audience.poll, self._recorder, now_ns, pausing=True)
        if now_ns < self._next_ns or not self._observers:
            return
        self._started_ns = self._started_ns or now_ns
        self._next_ns = now_ns + NS_PER_S
        run("status", self._publish_snapshot, now_ns)

    def _publish_snapshot(self, now_ns: int) -> None:
        snapshot = take_snapshot(self._recorder, self._log(), self._started_ns, now_ns)
        for part, watch in self._observers.items():
            self._recorder.bulkheads.run(part, self._show_snapshot, watch, snapshot, pausing=True)

    def _show_snapshot(self, watch: SnapshotObserver, snapshot: Snapshot) -> None:
        for event in watch(snapshot) or ():
            self._recorder.report_event(event)
