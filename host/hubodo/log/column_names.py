"""Columns of number files of other programs: channel, unit and time by their headings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from hubodo.errors import InputError
from hubodo.log.units import si_factor
from hubodo.recording import NODE_COLUMNS, NODE_OPTIONAL_COLUMNS

TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "100us": 1e-4, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
"""Seconds per unit of time; the micro sign and the Greek letter are different characters."""
_TIME_NAMES = (
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "stamp",
    "datetime",
    "date_time",
    "seconds_elapsed",
    "elapsed",
    "unittime",
    *("zeit", "uhrzeit", "zeitstempel", "temps", "horodatage", "tiempo", "tempo", "tijd"),
)
_SENSOR_NAMES = {
    "g": ("g|w|w_rs_s", "gyr|gyro|gyroscope|angular_velocity|angular_rate|rotation_rate|omega"),
    "a": ("a|gf|a_rs_s", "acc|accel|accelerometer|acceleration|specific_force"),
}
"""Short and long names of gyro and accelerometer; numbers of axes are recognised after long ones only."""
_NAME_UNITS = {
    "g": {
        "rad": "rad/s",
        "rad_s": "rad/s",
        "rads": "rad/s",
        "dps": "deg/s",
        "deg_s": "deg/s",
        "mdps": "mdeg/s",
    },
    "a": {"g": "g", "mg": "mg", "m_s2": "m/s^2", "ms2": "m/s^2", "mps2": "m/s^2", "mss": "m/s^2"},
}
"""Units within a name, such as `gyro_rad[0]`, `AccX_g` or `GyroX_dps`."""


def _channel_pattern(letter: str) -> re.Pattern[str]:
    short, long = _SENSOR_NAMES[letter]
    units = "|".join(_NAME_UNITS[letter])
    return re.compile(rf"(?:(?:{short})_?([xyz])|(?:{long})(?:_({units}))?_?([xyz012]))(?:_({units}))?")


_CHANNELS = tuple((letter, _channel_pattern(letter)) for letter in _SENSOR_NAMES)
_AXIS_OF_INDEX = str.maketrans("012", "xyz")
_TIME_OF_UNIT = {"ms": "ms", "millis": "ms", "us": "us", "micros": "us", "timeus": "us"}
"""Names of time columns that are units, as in sketches for Arduino; TimeUS of ArduPilot."""
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
        if name in _TIME_OF_UNIT:
            return NamedColumn("t", _TIME_OF_UNIT[name], heading)
        if name in NODE_OPTIONAL_COLUMNS:
            return NamedColumn(name, unit, heading)
        for letter, pattern in _CHANNELS:
            if channel := pattern.fullmatch(name):
                axis = (channel[1] or channel[3]).translate(_AXIS_OF_INDEX)
                named_unit = _NAME_UNITS[letter].get(channel[2] or channel[4] or "", "")
                return NamedColumn(letter + axis, unit or named_unit, heading)
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


def describe_other_table(headings: Sequence[str]) -> str:
    """Return where a table belongs that is not the table of one node, by its headings; "" if unknown."""
    names = [heading.strip().lower() for heading in headings]
    if any(name.startswith("lat") for name in names) and any(name.startswith("lon") for name in names):
        return "fixes stand in a folder: gnss.csv with t,latitude_deg,longitude_deg,altitude, beside left.csv"
    if any(word in name for name in names for word in ("tick", "encoder", "odometer", "wheel_speed")):
        return "speeds of wheels stand in a folder: wheels.csv with t,left,right in m/s"
    of_nodes = [name.partition(side)[2].strip("_. ") for side in ("left", "right") for name in names]
    if any(parse_heading(name).name in NODE_COLUMNS[1:] for name in of_nodes if name):
        return "write left.csv and right.csv into one folder; or name the columns of one node: --columns"
    return ""
