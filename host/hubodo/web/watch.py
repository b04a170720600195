"""What the page shows of the records that go into the log, and the recorder does not keep."""

from __future__ import annotations

from collections import deque

import numpy as np

from hubodo.log.records import EventRecord, GnssFix, ImuBlock, LogRecord
from hubodo.recording import Event


class Ear:
    """Small numbers from what is written: the mean spin of each node, fixes and events."""

    def __init__(self, most_events: int) -> None:
        self.events: deque[Event] = deque(maxlen=most_events)
        """Those that nobody has taken yet."""
        self.fix: tuple[float, float, float | None] | None = None
        """Latitude, longitude, degrees, and 1 sigma, m, of a fix that nobody has taken yet."""
        self._spin: dict[str, tuple[float, int]] = {}

    def hear(self, record: LogRecord) -> None:
        """See `hubodo.ingest.live.tee_sink.RecordListener`."""
        match record:
            case ImuBlock():
                total, count = self._spin.get(record.node, (0.0, 0))
                self._spin[record.node] = (total + float(record.gyro[:, 2].sum()), count + len(record.gyro))
            case EventRecord():
                self.events.append(record.event)
            case GnssFix() if record.status >= 0:
                sigma = record.sigma
                across = None if sigma is None else float(np.hypot(*sigma[:2]) / np.sqrt(2.0))
                self.fix = (record.latitude_deg, record.longitude_deg, across)

    def spins(self) -> dict[str, float]:
        """Mean rate about z of each node's samples since the last call, rad/s, node axes, raw."""
        spins = {node: total / count for node, (total, count) in self._spin.items()}
        self._spin.clear()
        return spins

    def take_events(self) -> list[Event]:
        """The events since the last call."""
        taken = list(self.events)
        self.events.clear()
        return taken
