"""A sink that writes the log and passes each record on to listeners."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.log.records import LogRecord, Sink

RecordListener = Callable[[LogRecord], None]
"""Called with each record after it was written; must return at once."""


class TeeSink:
    """A sink that writes to another one without interruption, then calls listeners behind their bulkheads."""

    def __init__(self, sink: Sink, listeners: Mapping[str, RecordListener], bulkheads: Bulkheads) -> None:
        """Start with these listeners, by name of their part."""
        self._sink, self._listeners, self._bulkheads = sink, dict(listeners), bulkheads

    def write_record(self, record: LogRecord, /) -> None:
        """Write a record and pass it on."""
        with self._bulkheads.protect_write():
            self._sink.write_record(record)
        for part, listener in self._listeners.items():
            self._bulkheads.run(part, listener, record, pausing=True)
