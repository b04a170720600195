"""Logs on disk: the vehicle that a log holds, and a recording written as a log."""

from __future__ import annotations

from pathlib import Path

from hubodo.errors import InputError
from hubodo.ingest.replay.odometry_setup import read_odometry_setup
from hubodo.log.any_log import open_source
from hubodo.log.csv_folder import write_folder
from hubodo.log.logfile import Log
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording
from hubodo.vehicle import Vehicle


def read_stored_vehicle(path: Path) -> Vehicle | None:
    """Return the vehicle that a log of this project holds, or None."""
    with open_source(path) as source:
        return read_odometry_setup(source).vehicle if isinstance(source, Log) else None


def write_log(recording: Recording, path: Path, vehicle: Vehicle | None) -> Path:
    """Write an MCAP file, or else a folder of CSV files; raise InputError if the path exists."""
    if path.exists():
        raise InputError(f"{path}: exists already; choose another name, nothing is overwritten")
    if path.suffix == ".mcap":
        write_recording(recording, path, vehicle=vehicle)
    else:
        write_folder(recording, path)
    return path
