"""Columns of number files of other programs: channel, unit and time by their headings."""

from __future__ import annotations

import re
from dataclasses import dataclass

from hubodo.errors import InputError
from hubodo.log.units import si_factor
from hubodo.recording import NODE_COLUMNS, NODE_OPTIONAL_COLUMNS

TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
"""Seconds per unit of time; the micro sign and the Greek letter are different characters."""
_TIME_NAMES = ("t", "time", "timestamp", "time_stamp", "datetime", "date_time", "seconds_elapsed")
_SENSOR_NAMES = {
    "g": "g|w|gyr|gyro|gyroscope|angular_velocity|angular_rate|rotation_rate|omega",
    "a": "a|acc|accel|accelerometer|acceleration|specific_force",
}
_CHANNELS = tuple((letter, re.compile(rf"(?:{names})_?([xyz])")) for letter, names in _SENSOR_NAMES.items())
_HEADING = re.compile(r"(.*?)\s*[(\[]([^()\[\]\d][^()\[\]]*)[)\]]\s*")
"""A heading with its unit in brackets; a number in brackets is the column of an array."""
_PLAIN_UNITS = ("", "-", "1", "°C", "degC", "C", "V")
_EPOCH_S = (1e9, 4.2e9)
"""Seconds since 1970 of the years 2001 to 2103; other times are seconds since the start of a record."""


@dataclass(frozen=True)
class NamedColumn:
    """A column with its meaning.

    Attributes:
        name: `t`, a channel of a node's table, or "" for another quantity.
        unit: unit in the heading, or "" without one.
        heading: heading in the file.
    """

    name: str
    unit: str
    heading: str


def parse_heading(heading: str) -> NamedColumn:
    """Return the meaning of a heading, such as `gx`, `Gyroscope x (rad/s)`, `timestamp_us` or `imu.acc_z`."""
    match = _HEADING.fullmatch(heading)
    text, unit = (match[1], match[2].strip()) if match else (heading, "")
    parts = re.split(r"[./]", text.lower())
    # A whole heading, or the end of a path such as `imu.angular_velocity.x`.
    for used in (parts, parts[-2:], parts[-1:]):
        name = re.sub(r"[^a-z0-9]+", "_", "_".join(used)).strip("_")
        stem, _, suffix = name.rpartition("_")
        if name in _TIME_NAMES:
            return NamedColumn("t", unit or ("s" if name == "seconds_elapsed" else ""), heading)
        if stem in _TIME_NAMES and suffix in TIME_UNITS_S:
            return NamedColumn("t", suffix, heading)
        if name in NODE_OPTIONAL_COLUMNS:
            return NamedColumn(name, unit, heading)
        for letter, pattern in _CHANNELS:
            if channel := pattern.fullmatch(name):
                return NamedColumn(letter + channel[1], unit, heading)
    return NamedColumn("", unit, heading)


def is_unit(text: str) -> bool:
    """Return True if a cell of a unit row is a known unit, in brackets or not."""
    unit = text.strip().strip("[]()").strip()
    if unit in _PLAIN_UNITS or unit in TIME_UNITS_S:
        return True
    try:
        si_factor(unit)
    except InputError:
        return False
    return True


def time_factor(unit: str, first: float) -> float:
    """Return the seconds per unit of a time column whose first value is `first`.

    Without a unit, times since 1970 are recognised by their size, others are in seconds. Raises KeyError for
    an unknown unit.
    """
    if unit:
        return TIME_UNITS_S[unit]
    for factor in (1.0, 1e-3, 1e-6, 1e-9):
        if is_epoch(first * factor):
            return factor
    return 1.0


def is_epoch(t: float) -> bool:
    """Return True if a time in s is a date, in seconds since 1970."""
    return _EPOCH_S[0] < t < _EPOCH_S[1]


def is_node_header(headings: tuple[str, ...]) -> bool:
    """Return True if time and channels have the names of a node's CSV file, which is in SI units."""
    last = [heading.replace("/", ".").rpartition(".")[2] for heading in headings]
    times = ("t", "t_ms", "t_us", "t_ns")
    return all(
        name in (*times, *NODE_COLUMNS) or parse_heading(name).name in ("", *NODE_OPTIONAL_COLUMNS)
        for name in last
    )
