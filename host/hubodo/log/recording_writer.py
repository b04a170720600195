"""Write a recording from memory to a log.

Topics: node -> /<node>/imu (+ /<node>/temperature, /<node>/battery), gnss -> /gnss/fix, truth -> /truth;
magnetometers, bias filters and odometry have their own. Values that a ROS message cannot hold to the last bit
(t between whole ns, a supply, which is a float32 there, unknown columns, sigma, files without a ROS type) are
written to /hubodo/columns/<file> (of a second accelerometer: high_g/<node>), one Float64MultiArray per row,
the column names in the channel's metadata `columns`. The metadata record `hubodo.csv` lists the columns of
each file in order. Row i of a file has sequence number i in every channel that holds a part of it, so that
readers can join the parts.
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
from hubodo.log.csv_table import MAX_TIME_S
from hubodo.log.log_writer import LogWriter
from hubodo.log.mcap_file import Compression
from hubodo.log.ros2 import UNKNOWN_VARIANCE
from hubodo.log.timebase import round_trips_exactly, to_ns
from hubodo.progress_callback import Progress
from hubodo.recording import BIAS_FILTER_COLUMNS, HIGH_G_SUFFIX, NODE_COLUMNS, Recording, Table
from hubodo.safe_text import json_text
from hubodo.units import NS_PER_S
from hubodo.vehicle import Vehicle

_ROWS_PER_BLOCK = 8192

LOSSLESS_ROS_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "gnss": ("latitude_deg", "longitude_deg", "altitude"),
    "truth": ("x", "y"),
}
"""Columns of a file that its ROS message holds to the last bit; see `lossless_ros_columns` for nodes."""


def lossless_ros_columns(name: str) -> tuple[str, ...]:
    """Return the columns of a file, except `t`, that its ROS messages hold to the last bit."""
    if name in ("reference", "wheels", "heading", "table") or name.endswith(HIGH_G_SUFFIX):
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
    """Write a recording as a log and return the number of messages.

    vehicle: the vehicle whose frames are written to /tf_static. Raises InputError if the path exists or the
    times span more than a ROS stamp holds (68 years). The log is written under a temporary name beside its
    final one, so a failure or a kill leaves no incomplete file of that name.
    """
    path = Path(path)
    require_free_path(path)
    writers = _table_writers(recording)
    for part in writers:
        if len(part.t_ns) and (part.t_ns.min() < 0 or part.t_ns.max() >= MAX_TIME_S * NS_PER_S):
            raise InputError(
                f"{part.name}: times from {part.t_ns.min() / NS_PER_S} s to {part.t_ns.max() / NS_PER_S} s "
                "do not fit a log, which holds 0 to 2147483647 s; shift t"
            )
    metadata = {key: text for key, text in recording.metadata.items() if not key.startswith("hubodo.")}
    with (
        atomic_new_file(path) as temporary,
        LogWriter(
            temporary, metadata=metadata, t_zero_ns=recording.t_zero_ns, compression=compression, clock=None
        ) as log,
    ):
        files = {name: json_text(list(table)) for name, table in recording.files().items()}
        log.add_metadata(topics.CSV_COLUMNS_RECORD, files)
        for event in recording.events:
            log.write_event(event)
        if vehicle is not None:
            log.write_static_frames(min((int(w.t_ns[0]) for w in writers if len(w.t_ns)), default=0), vehicle)
        _write_by_time(log, writers, progress)
    return log.message_count


@dataclass(frozen=True)
class _TableWriter:
    """The times of one table and the function that writes a range of its rows."""

    name: str
    t_ns: NDArray[np.int64]
    write: Callable[[LogWriter, NDArray[np.int64], slice], None]


def _write_by_time(log: LogWriter, writers: list[_TableWriter], progress: Progress | None) -> None:
    """Write all tables interleaved by time, so that reading by time needs few chunks at once."""
    total = sum(len(part.t_ns) for part in writers)
    if not total:
        return
    boundaries = np.sort(np.concatenate([part.t_ns for part in writers]))[_ROWS_PER_BLOCK::_ROWS_PER_BLOCK]
    done = [0] * len(writers)
    for mark in [*boundaries.tolist(), None]:
        for i, part in enumerate(writers):
            stop = len(part.t_ns) if mark is None else int(np.searchsorted(part.t_ns, mark))
            if stop > done[i]:
                rows = slice(done[i], stop)
                part.write(log, part.t_ns[rows], rows)
                done[i] = stop
        if progress:
            progress(f"writing {log.path.name}", sum(done) / total)


def _table_writers(recording: Recording) -> list[_TableWriter]:
    writers = [_file_writer(name, table, recording.t_zero_ns) for name, table in recording.files().items()]
    for node, table in recording.magnetometers.items():
        writers.append(
            _TableWriter(node, to_ns(table.t, recording.t_zero_ns), _magnetometer_writer(node, table))
        )
    for node, table in recording.bias_filters.items():
        writers.append(
            _TableWriter(node, to_ns(table.t, recording.t_zero_ns), _bias_filter_writer(node, table))
        )
    if recording.odometry is not None:
        odometry = recording.odometry
        writers.append(
            _TableWriter("odometry", to_ns(odometry.t, recording.t_zero_ns), _odometry_writer(odometry))
        )
    return writers


def _file_writer(name: str, table: Table, t_zero_ns: int) -> _TableWriter:
    exact = table.t_ns is not None or round_trips_exactly(table.t, t_zero_ns)
    t_ns = to_ns(table.t, t_zero_ns) if table.t_ns is None else table.t_ns + t_zero_ns
    float_columns = [c for c in table if c not in lossless_ros_columns(name) and not (c == "t" and exact)]
    float_values = {column: table[column] for column in float_columns}
    write_messages = {"gnss": _write_gnss, "truth": _write_truth}.get(
        name, _write_node if lossless_ros_columns(name) else None
    )

    def write(log: LogWriter, t_ns: NDArray[np.int64], rows: slice) -> None:
        if write_messages is not None:
            write_messages(log, name, table, t_ns, rows)
        if float_values or write_messages is None:
            values = {column: array[rows] for column, array in float_values.items()}
            log.write_columns(topics.columns_name(name), t_ns, t_ns, values)

    return _TableWriter(name, t_ns, write)


def _stack_columns(table: Table, names: tuple[str, ...], rows: slice) -> NDArray[np.float64]:
    return np.column_stack([table[name][rows] for name in names])


def _write_node(log: LogWriter, name: str, table: Table, t_ns: NDArray[np.int64], rows: slice) -> None:
    gyro, accel = (
        _stack_columns(table, ("gx", "gy", "gz"), rows),
        _stack_columns(table, ("ax", "ay", "az"), rows),
    )
    log.write_imu(name, t_ns, t_ns, gyro, accel)
    if "temperature" in table:
        log.write_temperature(name, t_ns, t_ns, table["temperature"][rows])
    if "supply" in table:
        with np.errstate(over="ignore"):
            log.write_battery(name, t_ns, t_ns, table["supply"][rows])


def _write_gnss(log: LogWriter, name: str, table: Table, t_ns: NDArray[np.int64], rows: slice) -> None:
    del name
    sigma: ArrayLike | None = None
    if "sigma" in table:
        sigma = np.repeat(table["sigma"][rows, None], 3, axis=1)
    position = [table[column][rows] for column in LOSSLESS_ROS_COLUMNS["gnss"]]
    with np.errstate(over="ignore"):
        log.write_gnss_fix(t_ns, t_ns, position[0], position[1], position[2], sigma=sigma)


def _write_truth(log: LogWriter, name: str, table: Table, t_ns: NDArray[np.int64], rows: slice) -> None:
    del name
    heading: Any = table["heading"][rows] if "heading" in table else np.zeros(len(t_ns))
    zero, covariance = np.zeros(len(t_ns)), np.zeros((len(t_ns), 3, 3))
    if "heading" not in table:
        covariance[:, 2, 2] = UNKNOWN_VARIANCE
    position = _stack_columns(table, ("x", "y"), rows)
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


def _magnetometer_writer(node: str, table: Table) -> Callable[[LogWriter, NDArray[np.int64], slice], None]:
    def write(log: LogWriter, t_ns: NDArray[np.int64], rows: slice) -> None:
        log.write_magnetic_field(node, t_ns, t_ns, _stack_columns(table, ("mx", "my", "mz"), rows))

    return write


def _bias_filter_writer(node: str, table: Table) -> Callable[[LogWriter, NDArray[np.int64], slice], None]:
    def write(log: LogWriter, t_ns: NDArray[np.int64], rows: slice) -> None:
        log.write_bias_filter(node, t_ns, t_ns, {name: table[name][rows] for name in BIAS_FILTER_COLUMNS[1:]})

    return write


def _odometry_writer(table: Table) -> Callable[[LogWriter, NDArray[np.int64], slice], None]:
    def write(log: LogWriter, t_ns: NDArray[np.int64], rows: slice) -> None:
        position = _stack_columns(table, ("x", "y"), rows)
        log.write_odometry(
            t_ns, t_ns, position, table["heading"][rows], table["speed"][rows], table["yaw_rate"][rows]
        )

    return write
