"""Tables of an imported log, restored without loss: each row is joined from its channels."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hubodo.log import role_tables, ros2, topics
from hubodo.log.decode import ChannelRows, parse_column_names
from hubodo.log.decoded_log import DecodedLog
from hubodo.log.recording_writer import lossless_ros_columns
from hubodo.log.row_matching import first_row_at_each_time, match_sequences, rows_of_sequences
from hubodo.log.timebase import MAX_EXACT_S, to_seconds
from hubodo.recording import NODE_COLUMNS, Table
from hubodo.units import NS_PER_S


def imported_tables(log: DecodedLog, imported: Mapping[str, str]) -> dict[str, Table]:
    """Return the tables of an imported log, each row joined from its channels by sequence number.

    imported: names of the columns of each table, as one text.
    """
    tables = {}
    for name, text in imported.items():
        columns = parse_column_names(text)
        if "t" not in columns:
            log.add_note(f"{name}: its list of columns is damaged; read by topic instead")
            continue
        parts = _channel_parts(log, name, columns)
        if not parts:
            tables[name] = Table({column: np.empty(0) for column in columns})
            continue
        common, lost = match_sequences([rows.sequence for rows, _ in parts])
        if lost:
            log.add_note(f"{name}: {lost} rows are incomplete because of damage; left out")
        since_zero_ns = parts[0][0].stamp_ns[rows_of_sequences(parts[0][0].sequence, common)] - log.t_zero_ns
        values_by_column = {"t": to_seconds(since_zero_ns, 0)}
        for rows, values in parts:
            chosen = rows_of_sequences(rows.sequence, common)
            values_by_column.update({column: array[chosen] for column, array in values.items()})
        has_exact_t = any("t" in values for _, values in parts)
        needs_t_ns = (
            len(since_zero_ns) > 0
            and int(np.abs(since_zero_ns).max()) >= MAX_EXACT_S * NS_PER_S
            and not has_exact_t
        )
        if absent := [column for column in columns if column not in values_by_column]:
            log.add_note(f"{name}: column {', '.join(absent)} is lost")
        increasing = first_row_at_each_time(values_by_column["t"])
        repeated = len(since_zero_ns) - len(since_zero_ns[increasing])
        if repeated:
            log.add_note(f"{name}: {repeated} rows repeat the time of another; left out")
        tables[name] = Table(
            {
                column: values_by_column[column][increasing]
                for column in columns
                if column in values_by_column
            },
            since_zero_ns[increasing] if needs_t_ns else None,
        )
    return tables


def _channel_parts(
    log: DecodedLog, name: str, columns: list[str]
) -> list[tuple[ChannelRows, dict[str, NDArray[np.float64]]]]:
    parts = []
    if (imu := log.rows_of_type(topics.imu_topic(name), ros2.IMU)) and "gx" in lossless_ros_columns(name):
        names = NODE_COLUMNS[1:]
        stacked = np.hstack([imu.values["angular_velocity"], imu.values["linear_acceleration"]])
        parts.append((imu, dict(zip(names, stacked.T, strict=True))))
        temperature = log.rows_of_type(topics.temperature_topic(name), ros2.TEMPERATURE)
        if "temperature" in columns and temperature:
            parts.append((temperature, {"temperature": temperature.values["temperature"]}))
    if name == "gnss" and (fix := log.rows_of_type(topics.GNSS_FIX, ros2.NAV_SAT_FIX)):
        parts.append((fix, role_tables.position_columns(fix)))
    if name == "truth" and (truth := log.rows_of_type(topics.TRUTH, ros2.ODOMETRY)):
        position = truth.values["pose.pose.position"]
        parts.append((truth, {"x": position[:, 0], "y": position[:, 1]}))
    topic = topics.COLUMNS_PREFIX + topics.columns_name(name)
    if others := log.rows_of_type(topic, ros2.FLOAT64_ARRAY):
        parts.append((others, log.named_columns(topic, others)))
    return parts
