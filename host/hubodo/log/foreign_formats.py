"""Number files of other programs whose units are documented, recognised by their headings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.log.column_names import NamedColumn
from hubodo.log.units import sensor_of_unit


@dataclass(frozen=True)
class ForeignFormat:
    """A format of another program.

    Attributes:
        name: the program.
        headings: headings that only its files have together, in lower case.
        gyro, accel: units of its columns.
        time_units: unit of its time column, by heading in lower case; others are not used.
        columns: channels of columns that `parse_heading` does not know, by heading in lower case.
    """

    name: str
    headings: frozenset[str]
    time_units: Mapping[str, str]
    gyro: str = "rad/s"
    accel: str = "m/s^2"
    columns: Mapping[str, str] = field(default_factory=dict)


CONVERSIONS = {
    b"ULog\x01\x12\x35": "a log of PX4; convert it with ulog2csv (pip install pyulog), and give the file "
    "*_sensor_combined_0.csv",
    b"\xa3\x95\x80\x80": "a log of ArduPilot; convert it with mavlogdump.py --types IMU --format csv "
    "(pip install pymavlink)",
    b"\xfa\xff": "a log of Xsens; export it as text with MT Manager",
    b"[{": "JSON; write its numbers as CSV",
    b"{": "JSON; write its numbers as CSV",
}
"""First bytes of files that must be converted, and how."""
SHEET_SUFFIXES = (".xlsx", ".xls", ".ods")
_PLAIN_AXES = ("x", "y", "z")
_FORMATS = (
    ForeignFormat("ArduPilot", frozenset({"timeus", "gyrx", "accx"}), time_units={"timeus": "us"}),
    ForeignFormat("PX4", frozenset({"timestamp", "gyro_rad[0]"}), time_units={"timestamp": "us"}),
    ForeignFormat(
        "PX4 sensor_gyro or sensor_accel",
        frozenset({"timestamp", "timestamp_sample", "device_id", *_PLAIN_AXES}),
        time_units={"timestamp_sample": "us"},
    ),
    ForeignFormat(
        "PX4 vehicle_imu",
        frozenset({"timestamp", "timestamp_sample", "delta_angle_dt"}),
        time_units={"timestamp_sample": "us"},
    ),
    ForeignFormat(
        "kalibr",
        frozenset({"timestamp", "omega_x", "alpha_x"}),
        time_units={"timestamp": "ns"},
        columns={f"alpha_{axis}": f"a{axis}" for axis in _PLAIN_AXES},
    ),
    ForeignFormat(
        "Movella DOT",
        frozenset({"sampletimefine", "euler_x", "gyr_x"}),
        gyro="deg/s",
        time_units={"sampletimefine": "us"},
    ),
    ForeignFormat(
        "Xsens MT Manager",
        frozenset({"packetcounter", "sampletimefine", "gyr_x"}),
        time_units={"sampletimefine": "100us"},
    ),
    ForeignFormat(
        "OpenLog Artemis",
        frozenset({"rtcdate", "ax", "gx"}),
        gyro="deg/s",
        accel="mg",
        time_units={"time": "s"},
    ),
    ForeignFormat("Physics Toolbox", frozenset({"time", "gfx", "wx"}), accel="g", time_units={"time": "s"}),
)
_ROS_FIELD = re.compile(r"(?:.*[./])?(angular_velocity|linear_acceleration)[./]([xyz])")
"""A field of sensor_msgs/Imu, which is in SI units, as PlotJuggler and rostopic name it."""
_INCREMENTS = {"delta_angle": "gyro (rad/s)", "delta_velocity": "accel (m/s^2)"}
"""Integrals that PX4 logs as vehicle_imu, with their integration times in µs, and channels of the rates."""
_AXIS_HEADING = re.compile(r"([xyz])(?:[-_ ]?axis)?")


def apply_foreign_format(columns: Sequence[NamedColumn], source: str) -> list[NamedColumn]:
    """Return the columns with the channels and units that the format of their file defines.

    source: path of the file; `gyro` or `acc` in its name says what columns `x`, `y`, `z` measure.
    """
    headings = {column.heading.strip().lower() for column in columns}
    known = next((it for it in _FORMATS if it.headings <= headings), None)
    return [_complete(column, known, source) for column in columns]


def rates_of_increments(headings: Sequence[str], values: Array) -> tuple[tuple[str, ...], Array]:
    """Return headings and values, with increments of angle and velocity divided by their durations."""
    names, rates = list(headings), values
    for increment, channel in _INCREMENTS.items():
        duration = f"{increment}_dt"
        indices = [f"{increment}[{axis}]" for axis in range(3)]
        if not {duration, *indices} <= set(headings):
            continue
        rates = rates.copy()
        for axis, heading in zip(_PLAIN_AXES, indices, strict=True):
            column = headings.index(heading)
            with np.errstate(divide="ignore", invalid="ignore"):
                rates[:, column] /= 1e-6 * values[:, headings.index(duration)]
            names[column] = channel.replace(" ", f"_{axis} ")
    return tuple(names), rates


def instance_rows(headings: Sequence[str], values: Array) -> dict[int, NDArray[np.intp]]:
    """Return the rows of each sensor by its number, in a log of ArduPilot; empty for other files."""
    if not {"TimeUS", "I"} <= set(headings):
        return {}
    numbers = values[:, headings.index("I")]
    return {
        int(number): np.flatnonzero(numbers == number) for number in np.unique(numbers[np.isfinite(numbers)])
    }


def _complete(column: NamedColumn, known: ForeignFormat | None, source: str) -> NamedColumn:
    heading = column.heading.strip().lower()
    if known is not None and (heading in known.time_units or column.name == "t"):
        unit = known.time_units.get(heading, "")
        return replace(column, name="t" if unit else "", unit=unit)
    if match := _ROS_FIELD.fullmatch(heading):
        letter = "g" if match[1] == "angular_velocity" else "a"
        return replace(
            column, name=letter + match[2], unit=column.unit or {"g": "rad/s", "a": "m/s^2"}[letter]
        )
    name = known.columns.get(heading, column.name) if known is not None else column.name
    if not name:
        name = _channel_of_axis(column, source)
    if known is not None and name[:1] in ("g", "a"):
        return replace(column, name=name, unit=column.unit or (known.gyro if name[0] == "g" else known.accel))
    return replace(column, name=name)


def _channel_of_axis(column: NamedColumn, source: str) -> str:
    """Return the channel of a column `x` or `x-axis` by its unit or by the name of its file, or ""."""
    text = column.heading.lower().partition("(")[0].partition("[")[0].strip()
    axis = _AXIS_HEADING.fullmatch(text)
    if axis is None:
        return ""
    sensor = sensor_of_unit(column.unit)
    stem = source.replace("\\", "/").rpartition("/")[2].lower()
    if not sensor:
        sensor = "g" if "gyro" in stem else "a" if "acc" in stem else ""
    return sensor + axis[1] if sensor else ""
