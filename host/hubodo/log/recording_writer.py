"""A recording in memory to a log.

Topics: node -> /<node>/imu (+ /<node>/temperature, /<node>/battery), gnss -> /gnss/fix, truth -> /truth,
magnetometers, bias filters and odometry to their own. What a ROS message cannot give back to the last bit (t
between whole ns, a supply, which is a float32 there, unknown columns, sigma, files without a ROS type) goes
to /hubodo/columns/<file>, one Float64MultiArray a row, the column names in the channel's metadata `columns`.
The metadata record `hubodo.csv` lists the columns of each file in order. Row i of a file has sequence number
i in every channel that carries a part of it: so rows meet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hubodo.atomic_files import atomic_new_file, require_free_path
from hubodo.errors import InputError
from hubodo.log import topics
from hubodo.log.csv_table import T_LIMIT
from hubodo.log.log_writer import LogWriter
from hubodo.log.mcap_file import Compression
from hubodo.log.ros2 import UNKNOWN_VARIANCE
from hubodo.log.timebase import round_trips_exactly, to_ns
from hubodo.recording import BIAS_FILTER_COLUMNS, NODE_COLUMNS, Recording, Table
from hubodo.safe_text import json_text
from hubodo.units import NS_PER_S
from hubodo.vehicle import Vehicle

Progress = Callable[[str, float], None]
_ROWS = 8192

LOSSLESS_ROS_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "gnss": ("latitude_deg", "longitude_deg", "altitude"),
    "truth": ("x", "y"),
}
"""Columns that a ROS message of the file carries to the last bit; nodes: six channels and temperature."""


def lossless_ros_columns(name: str) -> tuple[str, ...]:
    """The columns of a file that come back exactly from its ROS messages, `t` aside."""
    if name in ("reference", "wheels", "heading", "table"):
        return ()
    return LOSSLESS_ROS_COLUMNS.get(name, (*NODE_COLUMNS[1:], "temperature"))


def write_recording(
    recording: Recording,
    path: Path,
    *,
    compression: Compression = "zstd",
    vehicle: Vehicle | None = None,
    progress: Progress | None = None,
) -> int:
    """Write a recording as a log; returns the number of messages. vehicle: whose frames /tf_static tells.

    Raises InputError when the path exists or the times span more than a ROS stamp holds (68 years). It is
    written under a temporary name beside it, so a failure or a kill leaves no file of that name.
    """
    path = Path(path)
    require_free_path(path)
    parts = _parts(recording)
    for part in parts:
        if len(part.t_ns) and (part.t_ns.min() < 0 or part.t_ns.max() >= T_LIMIT * NS_PER_S):
            raise InputError(
                f"{part.name}: times from {part.t_ns.min() / NS_PER_S} s to {part.t_ns.max() / NS_PER_S} s "
                "do not fit a log, which holds 0 to 2147483647 s; shift t"
            )
    metadata = {key: text for key, text in recording.metadata.items() if not key.startswith("hubodo.")}
    with (
        atomic_new_file(path) as beside,
        LogWriter(
            beside, metadata=metadata, t_zero_ns=recording.t_zero_ns, compression=compression, clock=None
        ) as log,
    ):
        files = {name: json_text(list(table)) for name, table in recording.files().items()}
        log.add_metadata(topics.CSV_COLUMNS_RECORD, files)
        for event in recording.events:
            log.write_event(event)
        if vehicle is not None:
            log.write_static_frames(
                min((int(it.t_ns[0]) for it in parts if len(it.t_ns)), default=0), vehicle
            )
        _write_by_time(log, parts, progress)
    return log.message_count


@dataclass(frozen=True)
class _Part:
    """One table and how a run of its rows is written."""

    name: str
    t_ns: NDArray[np.int64]
    write: Callable[[LogWriter, NDArray[np.int64], slice], None]


def _write_by_time(log: LogWriter, parts: list[_Part], progress: Progress | None) -> None:
    """Write all tables side by side in time, so that a reader by time needs few chunks at once."""
    total = sum(len(part.t_ns) for part in parts)
    if not total:
        return
    marks = np.sort(np.concatenate([part.t_ns for part in parts]))[_ROWS::_ROWS]
    done = [0] * len(parts)
    for mark in [*marks.tolist(), None]:
        for i, part in enumerate(parts):
            stop = len(part.t_ns) if mark is None else int(np.searchsorted(part.t_ns, mark))
            if stop > done[i]:
                rows = slice(done[i], stop)
                part.write(log, part.t_ns[rows], rows)
                done[i] = stop
        if progress:
            progress(f"writing {log.path.name}", sum(done) / total)


def _parts(recording: Recording) -> list[_Part]:
    parts = [_file(name, table, recording.t_zero_ns) for name, table in recording.files().items()]
    for node, table in recording.magnetometers.items():
        parts.append(_Part(node, to_ns(table.t, recording.t_zero_ns), _magnetometer(node, table)))
    for node, table in recording.bias_filters.items():
        parts.append(_Part(node, to_ns(table.t, recording.t_zero_ns), _bias_filter(node, table)))
    if recording.odometry is not None:
        odometry = recording.odometry
        parts.append(_Part("odometry", to_ns(odometry.t, recording.t_zero_ns), _odometry(odometry)))
    return parts


def _file(name: str, table: Table, t_zero_ns: int) -> _Part:
    exact = table.t_ns is not None or round_trips_exactly(table.t, t_zero_ns)
    t_ns = to_ns(table.t, t_zero_ns) if table.t_ns is None else table.t_ns + t_zero_ns
    kept = [c for c in table if c not in lossless_ros_columns(name) and not (c == "t" and exact)]
    rest = {column: table[column] for column in kept}
    write_messages = {"gnss": _gnss, "truth": _truth}.get(name, _node if lossless_ros_columns(name) else None)

    def write(log: LogWriter, t_ns: NDArray[np.int64], rows: slice) -> None:
        if write_messages is not None:
            write_messages(log, name, table, t_ns, rows)
        if rest or write_messages is None:
            log.write_columns(name, t_ns, t_ns, {column: values[rows] for column, values in rest.items()})

    return _Part(name, t_ns, write)


def _stack(table: Table, names: tuple[str, ...], rows: slice) -> NDArray[np.float64]:
    return np.column_stack([table[name][rows] for name in names])


def _node(log: LogWriter, name: str, table: Table, t_ns: NDArray[np.int64], rows: slice) -> None:
    gyro, accel = _stack(table, ("gx", "gy", "gz"), rows), _stack(table, ("ax", "ay", "az"), rows)
    log.write_imu(name, t_ns, t_ns, gyro, accel)
    if "temperature" in table:
        log.write_temperature(name, t_ns, t_ns, table["temperature"][rows])
    if "supply" in table:
        with np.errstate(over="ignore"):
            log.write_battery(name, t_ns, t_ns, table["supply"][rows])


def _gnss(log: LogWriter, name: str, table: Table, t_ns: NDArray[np.int64], rows: slice) -> None:
    del name
    sigma: ArrayLike | None = None
    if "sigma" in table:
        sigma = np.repeat(table["sigma"][rows, None], 3, axis=1)
    position = [table[column][rows] for column in LOSSLESS_ROS_COLUMNS["gnss"]]
    with np.errstate(over="ignore"):
        log.write_gnss_fix(t_ns, t_ns, position[0], position[1], position[2], sigma=sigma)


def _truth(log: LogWriter, name: str, table: Table, t_ns: NDArray[np.int64], rows: slice) -> None:
    del name
    heading: Any = table["heading"][rows] if "heading" in table else np.zeros(len(t_ns))
    zero, covariance = np.zeros(len(t_ns)), np.zeros((len(t_ns), 3, 3))
    if "heading" not in table:
        covariance[:, 2, 2] = UNKNOWN_VARIANCE
    position = _stack(table, ("x", "y"), rows)
    log.write_odometry(
        t_ns,
        t_ns,
        position,
        heading,
        zero,
        zero,
        pose_covariance=covariance,
        topic=topics.TRUTH,
        frame="map",
        child_frame="truth",
    )


def _magnetometer(node: str, table: Table) -> Callable[[LogWriter, NDArray[np.int64], slice], None]:
    def write(log: LogWriter, t_ns: NDArray[np.int64], rows: slice) -> None:
        log.write_magnetic_field(node, t_ns, t_ns, _stack(table, ("mx", "my", "mz"), rows))

    return write


def _bias_filter(node: str, table: Table) -> Callable[[LogWriter, NDArray[np.int64], slice], None]:
    def write(log: LogWriter, t_ns: NDArray[np.int64], rows: slice) -> None:
        log.write_bias_filter(node, t_ns, t_ns, {name: table[name][rows] for name in BIAS_FILTER_COLUMNS[1:]})

    return write


def _odometry(table: Table) -> Callable[[LogWriter, NDArray[np.int64], slice], None]:
    def write(log: LogWriter, t_ns: NDArray[np.int64], rows: slice) -> None:
        position = _stack(table, ("x", "y"), rows)
        log.write_odometry(
            t_ns, t_ns, position, table["heading"][rows], table["speed"][rows], table["yaw_rate"][rows]
        )

    return write
