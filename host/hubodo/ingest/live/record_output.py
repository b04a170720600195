"""The interface of outputs of a recording to other programs, such as ROS 2 and MAVLink."""

from __future__ import annotations

from typing import Protocol

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.tee_sink import RecordListener


class RecordOutput(Protocol):
    """An output with a thread of its own, whose faults and hangs do not affect the recording."""

    def attach(self, bulkheads: Bulkheads) -> RecordListener:
        """Start the thread; return the function that queues a record."""
        ...

    def show(self, snapshot: Snapshot) -> None:
        """Queue the status of the recording; called once per second."""
        ...
