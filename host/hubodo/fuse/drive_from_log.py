"""Inputs of the forward model from a log: speed and yaw rate of its reference, or of its GNSS fixes."""

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
"""Rows; with fewer a smoothing spline cannot estimate the noise."""
_DRIVE_SAMPLE_INTERVAL = 0.02
"""s; the speed and yaw rate of a vehicle have no content above 25 Hz."""
_MIN_COURSE_SPEED = 0.2
"""m/s; below it the course says little about the heading, so the yaw rate fades to zero."""


def read_reference_drive(recording: Recording, log: str) -> MotionInputs:
    """Return speed and yaw rate of reference.csv, smoothed and starting at 0 s.

    Raises InputError when the log has no reference, or one of fewer than 20 rows.
    """
    table = _require_rows(recording.reference, "reference", log)
    t = table.t - table.t[0]
    inputs = MotionInputs(fit_smoothing_spline(t, table["speed"]), fit_smoothing_spline(t, table["yaw_rate"]))
    if "temperature" in table:
        inputs = MotionInputs(inputs.speed, inputs.yaw_rate, Trace(t, table["temperature"]))
    return inputs


def estimate_drive_from_fixes(recording: Recording, log: str) -> MotionInputs:
    """Return speed and yaw rate along a smooth curve through the fixes of gnss.csv, starting at 0 s.

    Raises InputError when the log has fewer than 20 fixes with a latitude on Earth.
    """
    table = _require_rows(recording.gnss, "gnss", log)
    on_earth = np.abs(table["latitude_deg"]) <= 90.0
    if not on_earth.all():
        rows = {name: values[on_earth] for name, values in table.columns.items()}
        table = _require_rows(Table(rows), "gnss", log)
    latitude, longitude = table["latitude_deg"], table["longitude_deg"]
    frame = make_local_frame(float(np.median(latitude)), float(np.median(longitude)))
    t = table.t - table.t[0]
    x, y = (fit_smoothing_spline(t, coordinate) for coordinate in frame.to_local(latitude, longitude))
    times: Array = np.arange(0.0, t[-1] + 0.5 * _DRIVE_SAMPLE_INTERVAL, _DRIVE_SAMPLE_INTERVAL)
    vx, vy = x(times, 1), y(times, 1)
    speed = np.hypot(vx, vy)
    yaw_rate = (vx * y(times, 2) - vy * x(times, 2)) / (speed**2 + _MIN_COURSE_SPEED**2)
    return MotionInputs(fit_interpolating_spline(times, speed), fit_interpolating_spline(times, yaw_rate))


def _require_rows(table: Table | None, name: str, log: str) -> Table:
    """Return the table; raise InputError if it is missing, too short, or not from one recording."""
    if table is None or len(table) < _MIN_DRIVE_ROWS:
        count = "none" if table is None else str(len(table))
        raise InputError(
            f"{log}: has {count} of the {_MIN_DRIVE_ROWS} rows of {name} that a drive needs; name another log"
        )
    check_time_gaps(table.t, f"{log}: {name}")
    return table
