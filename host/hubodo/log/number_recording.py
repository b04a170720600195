"""Read a table of numbers as a recording, with the metadata (rate, unit, columns) that it lacks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.column_names import (
    TIME_UNITS_S,
    NamedColumn,
    describe_other_table,
    is_epoch,
    is_node_header,
    parse_heading,
    time_factor,
)
from hubodo.log.foreign_formats import apply_foreign_format, instance_rows, rates_of_increments
from hubodo.log.number_file import FileKind, NumberTable, format_names, read_numbers
from hubodo.log.parquet_table import read_numeric_columns
from hubodo.log.roles import SELECT_BY_TYPE, TopicSelection
from hubodo.log.units import sensor_of_unit, si_factor
from hubodo.recording import NODE_COLUMNS, NODE_OPTIONAL_COLUMNS, Recording, Table
from hubodo.units import NS_PER_S

IMU_CHANNELS = NODE_COLUMNS[1:]
_MAX_ROW_SHIFT_S = 10.0  # a clock that goes back by more was reset
_TIME_COLUMNS = ("t", *(f"t_{unit}" for unit in ("ms", "us", "ns")), "time", "timestamp")
_KNOWN_COLUMNS = (*_TIME_COLUMNS, *IMU_CHANNELS, *NODE_OPTIONAL_COLUMNS)


@dataclass(frozen=True)
class InputFormat:
    """Metadata given by the user for a log that does not contain it.

    Attributes
    ----------
    rate : samples per second, for a file without times.
    units : units of gyro and accelerometer.
    columns : name of each column, as in the CSV folder; "-" omits one.
    variable : names of the arrays to read from a MATLAB or HDF5 file, comma-separated.
    channel : channel that a single column contains.
    topic_selection : which topic is which node or table.
    zeros : value of each channel at zero, in the numbers of the file, by channel.
    scales : units per number of the file, by channel.
    advice_without_time : what else to do about a file without times, for its error.
    used_channels : channels that the caller evaluates; others may lack a unit and are then left out.
    """

    rate: float | None = None
    units: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    variable: str | None = None
    channel: str = "gz"
    topic_selection: TopicSelection = SELECT_BY_TYPE
    zeros: Mapping[str, float] = field(default_factory=dict)
    scales: Mapping[str, float] = field(default_factory=dict)
    used_channels: tuple[str, ...] = IMU_CHANNELS
    advice_without_time: str = ""

    def si_factors(self) -> dict[str, float]:
        """Return the factors to SI of "gyro" and "accel" given by `units`. Raises InputError if unknown."""
        return dict(si_factor(unit) for unit in self.units)

    def apply_zero_and_scale(self, channel: str, values: Array) -> Array:
        """Return the values of a channel with its zero subtracted and its scale applied."""
        return np.asarray((values - self.zeros.get(channel, 0.0)) * self.scales.get(channel, 1.0))


def read_number_file(path: Path, kind: FileKind, input_format: InputFormat) -> Recording:
    """Read a number file as a recording of one node; channels that the file lacks are NaN.

    Raises InputError if columns, rate or unit are neither in the file nor in `input_format`.
    """
    numbers = read_numbers(path, kind, input_format.variable)
    is_si = kind == "text" and len(numbers.names) > 1 and is_node_header(numbers.names)
    return recording_from_numbers(str(path), path.name.split(".")[0], numbers, input_format, is_si=is_si)


def read_parquet_numbers(path: Path, input_format: InputFormat) -> Recording:
    """Read a Parquet file of another program as a recording of one node, as `read_number_file` does."""
    names, values = read_numeric_columns(path)
    numbers = NumberTable(values, names, {})
    return recording_from_numbers(str(path), path.name.split(".")[0], numbers, input_format)


def recording_from_numbers(
    source: str, node: str, numbers: NumberTable, input_format: InputFormat, *, is_si: bool = False
) -> Recording:
    """Return a table of numbers as a recording of one node; channels that it lacks are NaN.

    source: name for errors. is_si: True if columns without a unit are in SI units. Raises InputError if
    columns, rate or unit are neither in the table nor in `input_format`.
    """
    instances = instance_rows(numbers.names, numbers.values)
    if len(instances) > 1 and not input_format.columns:
        parts = {
            f"{node}_{number}": recording_from_numbers(
                source, node, replace(numbers, values=numbers.values[rows]), input_format, is_si=is_si
            )
            for number, rows in instances.items()
        }
        nodes = {name: part.nodes[node] for name, part in parts.items()}
        return Recording(nodes, warnings=next(iter(parts.values())).warnings)
    if not input_format.columns:
        names, values = rates_of_increments(numbers.names, numbers.values)
        numbers = replace(numbers, names=names, values=values)
    columns = _assign_columns(source, numbers, input_format)
    stated = zip(input_format.columns, numbers.names, strict=False)
    is_si = is_si and all(name in ("-", heading) for name, heading in stated)
    t, t_zero_ns = _read_times(source, numbers, columns, input_format)
    if len(t) and t[0] < 0.0:  # a log holds no negative times
        t_zero_ns = max(t_zero_ns, -math.floor(t[0]) * NS_PER_S)
    table: dict[str, Array] = {"t": t}
    factors = _channel_factors(source, numbers, columns, input_format, is_si)
    for index, column in enumerate(columns):
        values = numbers.values[:, index]
        if column.name in factors:
            values = input_format.apply_zero_and_scale(column.name, values)
            table[column.name] = values * factors[column.name]
        elif column.name in NODE_OPTIONAL_COLUMNS:
            table[column.name] = values
    left_out = [column.heading for column in columns if column.heading and column.name not in ("t", *table)]
    for name in IMU_CHANNELS:
        table.setdefault(name, np.full(len(t), np.nan))
    warnings = numbers.notes + ((f"{source}: left out: {format_names(left_out)}",) if left_out else ())
    return Recording({node: Table(table)}, warnings=warnings, t_zero_ns=t_zero_ns)


def convert_to_si(recording: Recording, input_format: InputFormat) -> Recording:
    """Convert gyro and accelerometer columns to SI by zero, scale and units of `input_format`."""
    factors = input_format.si_factors()
    if not factors and not input_format.zeros and not input_format.scales:
        return recording
    nodes = {}
    for name, table in recording.nodes.items():
        columns = {
            column: input_format.apply_zero_and_scale(column, values)
            * factors.get("gyro" if column[0] == "g" else "accel", 1.0)
            if column in IMU_CHANNELS
            else values
            for column, values in table.columns.items()
        }
        nodes[name] = Table(columns, table.t_ns)
    return Recording(**{**vars(recording), "nodes": nodes})


def _assign_columns(source: str, numbers: NumberTable, input_format: InputFormat) -> list[NamedColumn]:
    """Return the meaning of each column: as stated by the user, else by its heading."""
    width = numbers.values.shape[1]
    headings = numbers.names or ("",) * width
    if input_format.columns:
        if (count := len(input_format.columns)) != width:
            raise InputError(f"{source}: has {width} columns, --columns names {count}; name each, or use -")
        return [
            _column_of_user(name, heading)
            for name, heading in zip(input_format.columns, headings, strict=True)
        ]
    columns = apply_foreign_format([parse_heading(heading) for heading in headings], source)
    if any(column.name in IMU_CHANNELS for column in columns):
        return _without_repetitions(source, columns)
    if width == 1:
        return [NamedColumn(input_format.channel, columns[0].unit, headings[0])]
    if width == 2 and [column.name for column in columns].count("t") == 1:
        return [
            column if column.name == "t" else NamedColumn(input_format.channel, column.unit, column.heading)
            for column in columns
        ]
    named = f" ({format_names(numbers.names)})" if numbers.names else ""
    if other_kind := describe_other_table(headings):
        raise InputError(f"{source}: has {width} columns{named}; {other_kind}")
    n_channels = len(NODE_COLUMNS) - 1
    # Three columns are likely a gyro, six both sensors, without times.
    is_timed = width not in (n_channels // 2, n_channels)
    likely = NODE_COLUMNS[0 if is_timed else 1 : None if width >= n_channels else n_channels // 2 + 1][:width]
    example = ",".join([*likely, *("-" * (width - len(likely)))])
    rate = "" if is_timed or input_format.rate else " --rate HZ"
    raise InputError(
        f"{source}: has {width} columns{named}; name them, as in --columns {example}{rate}; - omits one"
    )


def _column_of_user(name: str, heading: str) -> NamedColumn:
    """Return a column as named by the user; raise InputError for an unknown name."""
    if name == "-":
        return NamedColumn("", "", heading)
    if name not in _KNOWN_COLUMNS:
        raise InputError(f"--columns: {name!r} is none of {', '.join(_KNOWN_COLUMNS)}, -")
    unit = parse_heading(heading).unit
    if name not in _TIME_COLUMNS:
        return NamedColumn(name, unit, heading)
    stated = name.partition("_")[2] or ("s" if name == "t" and not unit else unit)
    return NamedColumn("t", stated, heading)


def _without_repetitions(source: str, columns: Sequence[NamedColumn]) -> list[NamedColumn]:
    """Return the columns with one time: that in seconds, else the first.

    Raises InputError for a channel that appears twice.
    """
    times = [index for index, column in enumerate(columns) if column.name == "t"]
    times = [k for k in times if columns[k].unit in ("", *TIME_UNITS_S)] or times
    used = next((index for index in times if columns[index].unit == "s"), times[0] if times else None)
    with_one_time = [
        column if column.name != "t" or index == used else NamedColumn("", "", "")
        for index, column in enumerate(columns)
    ]
    for name in (*IMU_CHANNELS, *NODE_OPTIONAL_COLUMNS):
        same = [column.heading for column in with_one_time if column.name == name]
        if len(same) > 1:
            raise InputError(f"{source}: both {same[0]} and {same[1]} are {name}; choose with --columns")
    return with_one_time


def _read_times(
    source: str, numbers: NumberTable, columns: Sequence[NamedColumn], input_format: InputFormat
) -> tuple[Array, int]:
    """Return the times in s, and the date of their zero, ns since 1970, or 0 if they are no dates."""
    index = next((k for k, column in enumerate(columns) if column.name == "t"), None)
    if index is None:
        if input_format.rate is None:
            names = f" among {format_names(numbers.names)}" if numbers.names else ""
            raise InputError(
                f"{source}: has no time column{names}; give its samples per second with --rate"
                + (", or name the time with --columns t,..." if numbers.names else "")
                + input_format.advice_without_time
            )
        return np.arange(len(numbers.values)) / input_format.rate, 0
    column, values = columns[index], numbers.values[:, index]
    if input_format.rate is not None:
        raise InputError(
            f"{source}: has times in column {column.heading or 't'}; omit --rate, or the times, with "
            + _columns_without_time(columns)
        )
    if not np.isfinite(values).all():
        raise InputError(
            f"{source}: row {int(np.argmin(np.isfinite(values))) + 1} of its numbers has no finite time"
        )
    if column.unit and column.unit not in TIME_UNITS_S:
        raise InputError(
            f"{source}: {column.heading} is in {column.unit}; times must be in {', '.join(TIME_UNITS_S)}"
        )
    factor = time_factor(column.unit, float(values[0]) if len(values) else 0.0)
    t_zero = 0
    if column.heading != "t" and len(values) and is_epoch(float(values[0]) * factor):
        t_zero = int(float(values[0]) * factor)
    t = (values - t_zero / factor) * factor
    if fault := _describe_order(t):
        raise InputError(f"{source}: {fault.format(_columns_without_time(columns))}")
    return t, t_zero * NS_PER_S


def _describe_order(t: Array) -> str:
    """Return where times do not increase and what to do, with {} for the columns without time, else ""."""
    steps = np.diff(t)
    rows = np.flatnonzero(steps <= 0.0)
    if not len(rows):
        return ""
    where = f"row {int(rows[0]) + 2} of its numbers"
    if len(rows) == 1 and -steps[rows[0]] <= _MAX_ROW_SHIFT_S:
        return f"time does not increase at {where}; remove it"
    if (steps[rows] == 0.0).all():
        return (
            f"time does not increase at {where} and {len(rows) - 1} others: stamps are repeated; "
            "if the rate is constant, give it and omit the times, with {} --rate HZ"
        )
    others = f" and {len(rows) - 1} others" if len(rows) > 1 else ""
    return f"time goes back at {where}{others}; split the file there, or remove such rows"


def _columns_without_time(columns: Sequence[NamedColumn]) -> str:
    """Return the option that omits the times and all columns that are not used."""
    return "--columns " + ",".join("-" if column.name in ("", "t") else column.name for column in columns)


def _channel_factors(
    source: str, numbers: NumberTable, columns: Sequence[NamedColumn], input_format: InputFormat, is_si: bool
) -> dict[str, float]:
    """Return the factor to SI of each channel; those without a unit are left out if they are not used."""
    stated = input_format.si_factors()
    factors, missing = {}, []
    for column in (column for column in columns if column.name in IMU_CHANNELS):
        sensor = "gyro" if column.name[0] == "g" else "accel"
        unit = column.unit or numbers.units.get(column.heading.partition("[")[0], "")
        if sensor in stated:
            factors[column.name] = stated[sensor]
        elif sensor_of_unit(unit) == sensor[0]:
            factors[column.name] = si_factor(unit)[1]
        elif is_si:
            factors[column.name] = 1.0
        elif column.name in input_format.used_channels:
            missing.append(column.name)
    if missing:
        raise InputError(f"{source}: {_describe_missing_units(missing)}")
    return factors


def _describe_missing_units(channels: Sequence[str]) -> str:
    """Return what to state for the channels without a unit, both sensors at once."""
    examples = {"g": "--unit with one of rad/s, deg/s, mdeg/s, deg/h", "a": "--unit with one of m/s^2, g, mg"}
    sensors = [letter for letter in examples if any(name[0] == letter for name in channels)]
    return (
        f"the unit of {', '.join(channels)} is missing; give "
        + " and ".join(examples[letter] for letter in sensors)
        + ", or the value of one count, as in --unit '0.00875 deg/s'"
    )
