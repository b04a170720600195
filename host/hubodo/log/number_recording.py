"""Read a number file as a recording, with the metadata (rate, unit, columns) that it lacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.number_file import FileKind, NumberTable, format_names, read_numbers
from hubodo.log.roles import SELECT_BY_TYPE, TopicSelection
from hubodo.log.units import si_factor
from hubodo.recording import NODE_COLUMNS, NODE_OPTIONAL_COLUMNS, Recording, Table

IMU_CHANNELS = NODE_COLUMNS[1:]
_TIME_UNITS_S = {"t": 1.0, "t_ms": 1e-3, "t_us": 1e-6, "t_ns": 1e-9}
_KNOWN_COLUMNS = (*_TIME_UNITS_S, *IMU_CHANNELS, *NODE_OPTIONAL_COLUMNS)


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
    """

    rate: float | None = None
    units: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    variable: str | None = None
    channel: str = "gz"
    topic_selection: TopicSelection = SELECT_BY_TYPE

    def si_factors(self) -> dict[str, float]:
        """Return the factors to SI of "gyro" and "accel" given by `units`. Raises InputError if unknown."""
        return dict(si_factor(unit) for unit in self.units)


def read_number_file(path: Path, kind: FileKind, input_format: InputFormat) -> Recording:
    """Read a number file as a recording of one node; channels that the file lacks are NaN.

    Raises InputError if columns, rate or unit are neither in the file nor in `input_format`.
    """
    numbers = read_numbers(path, kind, input_format.variable)
    names = _assign_columns(path, numbers, input_format)
    # A text file with the header of the CSV folder is in SI units; any other needs a unit.
    is_node_csv = kind == "text" and not input_format.columns and len(names) > 1
    columns: dict[str, Array] = {"t": _read_times(path, numbers, names, input_format)}
    factors = _channel_factors(path, numbers, names, input_format, is_node_csv)
    for column, name in enumerate(names):
        if name in IMU_CHANNELS:
            columns[name] = numbers.values[:, column] * factors[name]
        elif name in NODE_OPTIONAL_COLUMNS:
            columns[name] = numbers.values[:, column]
    for name in IMU_CHANNELS:
        columns.setdefault(name, np.full(len(columns["t"]), np.nan))
    left_out = [
        label for label, name in zip(numbers.names, names, strict=False) if name not in _KNOWN_COLUMNS
    ]
    warnings = (f"{path}: left out: {format_names(left_out)}",) if left_out else ()
    return Recording({path.name.split(".")[0]: Table(columns)}, warnings=warnings)


def convert_to_si(recording: Recording, input_format: InputFormat) -> Recording:
    """Convert gyro and accelerometer columns from the units of `input_format` to SI."""
    factors = input_format.si_factors()
    if not factors:
        return recording
    nodes = {}
    for name, table in recording.nodes.items():
        columns = {
            column: values * factors.get("gyro" if column[0] == "g" else "accel", 1.0)
            if column in IMU_CHANNELS
            else values
            for column, values in table.columns.items()
        }
        nodes[name] = Table(columns, table.t_ns)
    return Recording(**{**vars(recording), "nodes": nodes})


def _assign_columns(path: Path, numbers: NumberTable, input_format: InputFormat) -> tuple[str, ...]:
    """Return the name of each column."""
    width = numbers.values.shape[1]
    if input_format.columns:
        if (count := len(input_format.columns)) != width:
            raise InputError(f"{path}: has {width} columns, --columns names {count}; name each, or use -")
        for name in input_format.columns:
            if name not in _KNOWN_COLUMNS and name != "-":
                raise InputError(f"--columns: {name!r} is none of {', '.join(_KNOWN_COLUMNS)}, -")
        return input_format.columns
    last = tuple(name.replace("/", ".").rpartition(".")[2] for name in numbers.names)
    if any(name in IMU_CHANNELS for name in last):
        return last
    if width == 1:
        return (input_format.channel,)
    named = f" ({format_names(numbers.names)})" if numbers.names else ""
    raise InputError(
        f"{path}: has {width} columns{named}; name them, as in --columns t,gx,gy,gz,ax,ay,az; - omits one"
    )


def _read_times(path: Path, numbers: NumberTable, names: tuple[str, ...], input_format: InputFormat) -> Array:
    time_column = next((k for k, name in enumerate(names) if name in _TIME_UNITS_S), None)
    if time_column is None:
        if input_format.rate is None:
            raise InputError(f"{path}: has no time column; give its samples per second with --rate")
        return np.arange(len(numbers.values)) / input_format.rate
    if input_format.rate is not None:
        raise InputError(f"{path}: has times in column {names[time_column]}; omit --rate")
    t = numbers.values[:, time_column] * _TIME_UNITS_S[names[time_column]]
    if not np.isfinite(t).all():
        raise InputError(
            f"{path}: row {int(np.argmin(np.isfinite(t))) + 1} of its numbers has no finite time"
        )
    non_increasing = np.flatnonzero(np.diff(t) <= 0.0)
    if len(non_increasing):
        raise InputError(
            f"{path}: time does not increase at row {int(non_increasing[0]) + 2} of its numbers; remove it"
        )
    return t


def _channel_factors(
    path: Path, numbers: NumberTable, names: tuple[str, ...], input_format: InputFormat, is_node_csv: bool
) -> Mapping[str, float]:
    """Return the factor to SI for each channel."""
    stated = input_format.si_factors()
    factors = {}
    for column, name in enumerate(names):
        if name not in IMU_CHANNELS:
            continue
        sensor = "gyro" if name[0] == "g" else "accel"
        label = numbers.names[column].partition("[")[0] if numbers.names else ""
        if sensor in stated:
            factors[name] = stated[sensor]
        elif label in numbers.units and si_factor(numbers.units[label])[0] == sensor:
            factors[name] = si_factor(numbers.units[label])[1]
        elif is_node_csv:
            factors[name] = 1.0
        else:
            known = "rad/s, deg/s, mdeg/s, deg/h" if sensor == "gyro" else "m/s^2, g, mg"
            raise InputError(
                f"{path}: the unit of {name} is missing; give --unit with one of {known}, or the "
                "value of one count, as in --unit '0.00875 deg/s'"
            )
    return factors
