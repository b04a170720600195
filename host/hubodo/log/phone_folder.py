"""Read folders that the phone apps Sensor Logger and phyphox export: one CSV file per sensor."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.column_names import NamedColumn, parse_heading
from hubodo.log.number_text import read_text_table
from hubodo.log.units import si_factor
from hubodo.recording import NODE_COLUMNS, Recording, Table
from hubodo.units import NS_PER_S

NODE_NAME = "phone"
_GYRO_FILE = "Gyroscope.csv"
_ACCEL_FILES = ("TotalAcceleration.csv", "Accelerometer.csv")
_GRAVITY_FILE = "Gravity.csv"
_AXES = ("x", "y", "z")
_CARRIED_FORCE_RANGE = (8.0, 12.0)
"""Median of the specific force, m/s², of a phone that is mostly at rest or carried."""


def is_phone_folder(folder: Path) -> bool:
    """Return True if a folder holds a file of gyro rates with the header of one of the apps."""
    path = folder / _GYRO_FILE
    if not path.is_file():
        return False
    with path.open(encoding="utf-8-sig", errors="replace") as stream:
        header = stream.readline(4096)
    delimiter = ";" if ";" in header else "\t" if "\t" in header else ","
    return _channels([cell.strip().strip('"') for cell in header.split(delimiter)], "g") is not None


def read_phone_folder(folder: Path) -> Recording:
    """Return the gyro rates, with the specific force interpolated to their times, as the node `phone`.

    Raises InputError for a malformed file, or times that do not overlap.
    """
    t, rates, t_zero_ns = _read_sensor(folder / _GYRO_FILE, "g")
    force, note = _read_force(folder, t)
    columns = {"t": t}
    columns |= dict(zip(NODE_COLUMNS[1:4], rates.T, strict=True))
    columns |= dict(zip(NODE_COLUMNS[4:], force.T, strict=True))
    warnings = (f"{folder}: {note}",) if note else ()
    return Recording(
        {NODE_NAME: Table(columns)}, metadata={"source": "phone"}, warnings=warnings, t_zero_ns=t_zero_ns
    )


def _read_force(folder: Path, t: Array) -> tuple[Array, str]:
    """Return the specific force (N, 3) at times t, or NaN with the reason in one line."""
    missing = np.full((len(t), 3), np.nan)
    for name in _ACCEL_FILES:
        if not (folder / name).is_file():
            continue
        force = _at_times(folder / name, t)
        if _is_specific_force(force):
            return force, ""
        if (folder / _GRAVITY_FILE).is_file():
            total = force + _at_times(folder / _GRAVITY_FILE, t)
            if _is_specific_force(total):
                return total, ""
        return missing, f"{name} left out: it lacks gravity; record {_GRAVITY_FILE} or {_ACCEL_FILES[0]} too"
    return missing, f"has no {_ACCEL_FILES[1]}; only the gyro is used"


def _at_times(path: Path, t: Array) -> Array:
    """Return a sensor with three axes at times t, NaN beyond its own times."""
    own, values, _ = _read_sensor(path, "a")
    return np.column_stack([np.interp(t, own, axis, left=np.nan, right=np.nan) for axis in values.T])


def _is_specific_force(force: Array) -> bool:
    lengths = np.linalg.norm(force, axis=1)
    known = lengths[np.isfinite(lengths)]
    return bool(len(known)) and _CARRIED_FORCE_RANGE[0] < float(np.median(known)) < _CARRIED_FORCE_RANGE[1]


def _read_sensor(path: Path, sensor: str) -> tuple[Array, Array, int]:
    """Return times in s, values (N, 3) in SI units, and the date of t = 0 in ns since 1970, or 0.

    Rows whose time does not increase are left out. Raises InputError for another header.
    """
    values, headings, _ = read_text_table(path)
    columns = _channels(list(headings), sensor)
    if columns is None:
        raise InputError(f"{path}: has no time and three axes in its header; convert it to a node's CSV file")
    index = {name: position for name, (position, _) in columns.items()}
    t = values[:, index["t"]]
    rows = np.flatnonzero(np.diff(np.maximum.accumulate(t), prepend=-np.inf) > 0.0)
    stamp = headings.index("time") if "time" in headings and headings[index["t"]] != "time" else None
    # Sensor Logger: `time` is in ns since 1970, `seconds_elapsed` since the start of the recording.
    t_zero_ns = 0
    if stamp is not None and len(rows):
        # A float64 holds these stamps to 256 ns.
        t_zero_ns = int(values[rows[0], stamp]) - round(float(t[rows[0]]) * NS_PER_S)
    factors = [_si_factor(columns[axis][1], sensor) for axis in _AXES]
    triad = np.column_stack([values[rows, index[axis]] for axis in _AXES]) * factors
    return t[rows], triad, max(t_zero_ns, 0)


def _channels(headings: list[str], sensor: str) -> Mapping[str, tuple[int, NamedColumn]] | None:
    """Return position and meaning of `t`, `x`, `y`, `z`; None for another header.

    The columns of Sensor Logger are plain axes, those of phyphox name sensor and unit.
    """
    columns = [parse_heading(heading) for heading in headings]
    channels: dict[str, tuple[int, NamedColumn]] = {}
    for position, column in enumerate(columns):
        axis = column.heading.strip().lower() if "seconds_elapsed" in headings else column.name[1:]
        if column.name == "t" and column.unit == "s":
            channels.setdefault("t", (position, column))
        elif axis in _AXES and (column.name[:1] == sensor or not column.name):
            channels.setdefault(axis, (position, column))
    return channels if len(channels) == len(_AXES) + 1 else None


def _si_factor(column: NamedColumn, sensor: str) -> float:
    """Return the factor to SI of a column; without a unit it is in SI units, as in Sensor Logger."""
    if not column.unit:
        return 1.0
    kind, factor = si_factor(column.unit)
    if kind[0] != sensor:
        raise InputError(f"{column.heading}: is not the unit of this sensor; correct the header")
    return factor
