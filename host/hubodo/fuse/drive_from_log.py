"""The drive that a log tells of, as inputs of the forward model: from its reference, or through its fixes."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.projection import make_local_frame
from hubodo.model.inputs import MotionInputs, Trace
from hubodo.recording import Recording, Table
from hubodo.smoothing_spline import fit_interpolating_spline, fit_smoothing_spline
from hubodo.time_gaps import check_time_gaps

_MIN_DRIVE_ROWS = 20
"""Rows; fewer are no drive, and a smoothing spline has nothing to judge its noise by."""
_DRIVE_SAMPLE_INTERVAL = 0.02
"""s; a vehicle's speed and yaw rate have nothing above 25 Hz."""
_MIN_COURSE_SPEED = 0.2
"""m/s; at less than this a course says little about where the vehicle points, so the turn fades out."""


def read_reference_drive(recording: Recording, where: str) -> MotionInputs:
    """Speed and yaw rate of reference.csv without their noise, begun at 0 s.

    Raises InputError when the log has none, or fewer than 20 rows.
    """
    table = _require_rows(recording.reference, "reference", where)
    t = table.t - table.t[0]
    inputs = MotionInputs(fit_smoothing_spline(t, table["speed"]), fit_smoothing_spline(t, table["yaw_rate"]))
    if "temperature" in table:
        inputs = MotionInputs(inputs.speed, inputs.yaw_rate, Trace(t, table["temperature"]))
    return inputs


def estimate_drive_from_fixes(recording: Recording, where: str) -> MotionInputs:
    """Speed and yaw rate along a smooth curve through the fixes of gnss.csv, begun at 0 s.

    Raises InputError when the log has none, or fewer than 20 that are a place on Earth.
    """
    table = _require_rows(recording.gnss, "gnss", where)
    on_earth = np.abs(table["latitude_deg"]) <= 90.0
    if not on_earth.all():
        rows = {name: values[on_earth] for name, values in table.columns.items()}
        table = _require_rows(Table(rows), "gnss", where)
    latitude, longitude = table["latitude_deg"], table["longitude_deg"]
    frame = make_local_frame(float(np.median(latitude)), float(np.median(longitude)))
    t = table.t - table.t[0]
    x, y = (fit_smoothing_spline(t, place) for place in frame.to_local(latitude, longitude))
    at: Array = np.arange(0.0, t[-1] + 0.5 * _DRIVE_SAMPLE_INTERVAL, _DRIVE_SAMPLE_INTERVAL)
    vx, vy = x(at, 1), y(at, 1)
    speed = np.hypot(vx, vy)
    yaw_rate = (vx * y(at, 2) - vy * x(at, 2)) / (speed**2 + _MIN_COURSE_SPEED**2)
    return MotionInputs(fit_interpolating_spline(at, speed), fit_interpolating_spline(at, yaw_rate))


def _require_rows(table: Table | None, name: str, where: str) -> Table:
    if table is None or len(table) < _MIN_DRIVE_ROWS:
        count = "none" if table is None else str(len(table))
        raise InputError(
            f"{where}: has {count} of the {_MIN_DRIVE_ROWS} rows of {name} that a drive needs; "
            "name another log"
        )
    check_time_gaps(table.t, f"{where}: {name}")
    return table
