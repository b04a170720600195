"""Whose log it is and when it began, from what stands beside its samples."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hubodo.errors import HubodoError
from hubodo.ingest.replay.odometry_setup import read_odometry_setup
from hubodo.log.any_log import open_source
from hubodo.log.logfile import Log

_EARLIEST = datetime(2000, 1, 1, tzinfo=UTC).timestamp() * 1e9
"""ns; a clock that shows less counts from when it was switched on."""


def identity(log: Path, folder: str) -> dict[str, Any]:
    """`vehicle`, the name in the vehicle file that is kept in the log, else the folder's; `start`, UTC.

    start: None where the log does not tell. What cannot be read is told by who reads all of it.
    """
    name, start = folder, None
    try:
        with open_source(log) as source:
            if source is not None and source.t_zero_ns is not None and source.t_zero_ns > _EARLIEST:
                start = datetime.fromtimestamp(source.t_zero_ns / 1e9, UTC)
            if isinstance(source, Log) and (kept := read_odometry_setup(source).vehicle) is not None:
                name = kept.name or folder
    except (HubodoError, OSError, ValueError, OverflowError):
        pass
    return {"vehicle": name, "start": start}
