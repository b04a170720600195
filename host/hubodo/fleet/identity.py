"""Read the vehicle and start time of a log from its metadata."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hubodo.errors import HubodoError
from hubodo.ingest.replay.odometry_setup import read_odometry_setup
from hubodo.log.any_log import open_source
from hubodo.log.logfile import Log

_EARLIEST_START_NS = datetime(2000, 1, 1, tzinfo=UTC).timestamp() * 1e9
"""ns since 1970; an earlier time comes from a clock that was never set."""


def read_identity(log: Path, folder: str) -> dict[str, Any]:
    """Return `vehicle` (name in the attached vehicle file, else the folder) and `start` (UTC or None).

    Unreadable logs raise no error here; the analysis of the log reports them.
    """
    name, start = folder, None
    try:
        with open_source(log) as source:
            if source is not None and source.t_zero_ns is not None and source.t_zero_ns > _EARLIEST_START_NS:
                start = datetime.fromtimestamp(source.t_zero_ns / 1e9, UTC)
            if isinstance(source, Log) and (vehicle := read_odometry_setup(source).vehicle) is not None:
                name = vehicle.name or folder
    except (HubodoError, OSError, ValueError, OverflowError):
        pass
    return {"vehicle": name, "start": start}
