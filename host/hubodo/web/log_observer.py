"""Extraction of wheel rates, fixes and events from the records written to the log."""

from __future__ import annotations

from collections import deque

import numpy as np

from hubodo.log.records import EventRecord, GnssFix, ImuBlock, LogRecord
from hubodo.recording import Event


class LogObserver:
    """A listener of the log that accumulates mean rates, the newest fix and events for the page."""

    def __init__(self, max_events: int) -> None:
        self.events: deque[Event] = deque(maxlen=max_events)
        """Events since the last `take_events`."""
        self.fix: tuple[float, float, float | None] | None = None
        """Latitude and longitude in degrees, and 1σ in m, of a new fix."""
        self._spin: dict[str, tuple[float, int]] = {}

    def observe(self, record: LogRecord) -> None:
        """Accumulate a record; see `hubodo.ingest.live.tee_sink.RecordListener`."""
        match record:
            case ImuBlock():
                total, count = self._spin.get(record.node, (0.0, 0))
                self._spin[record.node] = (total + float(record.gyro[:, 2].sum()), count + len(record.gyro))
            case EventRecord():
                self.events.append(record.event)
            case GnssFix() if record.status >= 0:
                sigma = record.sigma
                horizontal_sigma = None if sigma is None else float(np.hypot(*sigma[:2]) / np.sqrt(2.0))
                self.fix = (record.latitude_deg, record.longitude_deg, horizontal_sigma)

    def take_mean_rates(self) -> dict[str, float]:
        """Return the mean raw rate about z of each node since the last call, rad/s, node axes."""
        spins = {node: total / count for node, (total, count) in self._spin.items()}
        self._spin.clear()
        return spins

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events = list(self.events)
        self.events.clear()
        return events
