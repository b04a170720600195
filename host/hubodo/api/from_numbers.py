"""`hubodo.from_frame` and `hubodo.from_arrays`, which make a log of numbers in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hubodo.api.log import LoadedLog
from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.column_names import is_node_header, parse_heading
from hubodo.log.number_file import NumberTable
from hubodo.log.number_recording import IMU_CHANNELS, InputFormat, recording_from_numbers
from hubodo.units import NS_PER_S

_SENSORS = {"g": "gyro", "a": "accel"}

if TYPE_CHECKING:
    import pandas as pd


def from_frame(
    frame: pd.DataFrame,
    *,
    units: Sequence[str] = (),
    columns: Sequence[str] = (),
    rate: float | None = None,
    node: str = "imu",
    channel: str = "gz",
    zeros: Mapping[str, float] | None = None,
    scales: Mapping[str, float] | None = None,
) -> LoadedLog:
    """Make a log of one node from a pandas data frame.

    Columns and units are recognised by their names, as in a file: `gx`, `acc_z`, `Gyroscope x (rad/s)`. Times
    are the index if it is named `t` or `time` or holds dates, else a column.

    Parameters
    ----------
    frame : pandas.DataFrame
        The samples, one row each. A frame of `LoadedLog.frame` is in SI units.
    units : sequence of str
        Units of gyro and accelerometer: `deg/s`, `g`, or `0.00875 deg/s` per count.
    columns : sequence of str
        Meaning of each column, such as `["gx", "gy", "-"]`; "-" ignores one.
    rate : float, optional
        Sample rate in Hz of a frame without times.
    node : str
        Name of the node.
    channel : str
        Channel that a single column contains.
    zeros, scales : mapping of str to float, optional
        Counts at zero, and units per count, by channel.

    Returns
    -------
    LoadedLog
        The log.

    Raises
    ------
    InputError
        If columns, unit or times are unknown.
    """
    names, arrays, t_zero_ns = [], [], None
    index = getattr(frame.index, "tz", None) and frame.index.tz_convert("UTC").tz_localize(None)
    stamps = np.asarray(frame.index if index is None else index)
    is_dates = stamps.dtype.kind in "mM"
    if is_dates or parse_heading(str(frame.index.name or "")).name == "t":
        values, t_zero_ns = _times(stamps)
        names.append("t" if is_dates else str(frame.index.name))
        arrays.append(values)
    given = list(columns)
    for position, name in enumerate(map(str, frame.columns)):
        column = np.asarray(frame.iloc[:, position])
        if column.dtype.kind in "mM":
            values, t_zero_ns = _times(column)
            name = "t"
        else:
            try:
                values = np.asarray(column, np.float64)
            except (TypeError, ValueError):
                if not given or given[position] != "-":
                    raise InputError(f"the data frame: column {name!r} does not hold numbers") from None
                values = np.full(len(column), np.nan)
        names.append(name)
        arrays.append(values)
    if given and len(names) > len(frame.columns):
        given = ["t", *given]
    return _loaded_log(
        "the data frame", names, arrays, t_zero_ns, node, units, given, rate, channel, zeros, scales
    )


def from_arrays(
    gyro: ArrayLike | None = None,
    accel: ArrayLike | None = None,
    *,
    t: ArrayLike | None = None,
    rate: float | None = None,
    units: Sequence[str] = (),
    temperature: ArrayLike | None = None,
    node: str = "imu",
    channel: str = "gz",
    zeros: Mapping[str, float] | None = None,
    scales: Mapping[str, float] | None = None,
) -> LoadedLog:
    """Make a log of one node from arrays; without `units` they are in rad/s and m/s².

    Parameters
    ----------
    gyro, accel : array_like, optional
        (N, 3), or (N,) for the one channel `channel`.
    t : array_like, optional
        (N,) times in s, or dates as `datetime64`.
    rate : float, optional
        Sample rate in Hz of arrays without `t`.
    units : sequence of str
        Units of gyro and accelerometer: `deg/s`, `g`, or `0.00875 deg/s` per count.
    temperature : array_like, optional
        (N,) °C.
    node : str
        Name of the node.
    channel : str
        Channel of a single axis.
    zeros, scales : mapping of str to float, optional
        Counts at zero, and units per count, by channel.

    Returns
    -------
    LoadedLog
        The log.

    Raises
    ------
    InputError
        If there are no samples, their shapes differ, or times and rate are missing.
    """
    names: list[str] = []
    arrays: list[Array] = []
    t_zero_ns = None
    if t is not None:
        values, t_zero_ns = _times(np.asarray(t))
        names.append("t")
        arrays.append(values)
    for sensor, given in (("g", gyro), ("a", accel)):
        if given is None:
            continue
        triad = np.asarray(given, np.float64)
        if triad.ndim == 2 and triad.shape[1] == 3:
            names += [sensor + axis for axis in "xyz"]
            arrays += list(triad.T)
        elif triad.ndim == 1 and channel in IMU_CHANNELS and channel[0] == sensor:
            names.append(channel)
            arrays.append(triad)
        else:
            raise InputError(
                f"{_SENSORS[sensor]} has shape {triad.shape}; give (N, 3), or (N,) with its channel"
            )
    if not names or names == ["t"]:
        raise InputError("no samples: give gyro, accel or both")
    if temperature is not None:
        names.append("temperature")
        arrays.append(np.asarray(temperature, np.float64))
    return _loaded_log("arrays", names, arrays, t_zero_ns, node, units, (), rate, channel, zeros, scales)


def _times(stamps: np.ndarray[Any, Any]) -> tuple[Array, int | None]:
    """Return times in s, and the date of their zero in ns since 1970 if they are dates."""
    if stamps.dtype.kind == "m":
        return np.asarray(stamps.astype("timedelta64[ns]").astype(np.int64) * 1e-9, np.float64), None
    if stamps.dtype.kind != "M" or not len(stamps):
        return np.asarray(stamps, np.float64), None
    ns = stamps.astype("datetime64[ns]").astype(np.int64)
    t_zero_ns = int(ns[0]) // NS_PER_S * NS_PER_S
    return np.asarray((ns - t_zero_ns) * 1e-9, np.float64), t_zero_ns


def _loaded_log(
    source: str,
    names: Sequence[str],
    arrays: Sequence[Array],
    t_zero_ns: int | None,
    node: str,
    units: Sequence[str],
    columns: Sequence[str],
    rate: float | None,
    channel: str,
    zeros: Mapping[str, float] | None,
    scales: Mapping[str, float] | None,
) -> LoadedLog:
    """Return the log of columns of numbers by name; columns with the names of a node are in SI units."""
    if len({len(values) for values in arrays}) > 1 or not arrays:
        lengths = ", ".join(f"{name} {len(values)}" for name, values in zip(names, arrays, strict=True))
        raise InputError(f"{source}: columns differ in length ({lengths or 'there is none'})")
    numbers = NumberTable(np.column_stack(arrays), tuple(names), {})
    stated = (units,) if isinstance(units, str) else tuple(units)
    form = InputFormat(
        rate, stated, tuple(columns), channel=channel, zeros=dict(zeros or {}), scales=dict(scales or {})
    )
    recording = recording_from_numbers(source, node, numbers, form, is_si=is_node_header(numbers.names))
    if t_zero_ns is not None:
        recording = replace(recording, t_zero_ns=t_zero_ns)
    return LoadedLog(Path(source), recording)
