"""Build a recording from the messages of a log: hubodo's own losslessly, others by the role of each topic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hubodo.log import role_tables, ros2, topics
from hubodo.log.decode import (
    ChannelRows,
    normalise_type_name,
)
from hubodo.log.decoded_log import DecodedLog
from hubodo.log.imported_tables import imported_tables
from hubodo.log.logfile import Log, LogMessage, open_log
from hubodo.log.roles import SELECT_BY_TYPE, RoleAssignment, TopicCandidate, TopicSelection, assign_roles
from hubodo.log.row_checks import drop_non_finite_rows
from hubodo.log.source import MessageSource, Stream, is_hubodo_log
from hubodo.log.timebase import to_seconds
from hubodo.progress_callback import Progress
from hubodo.recording import (
    BIAS_FILTER_COLUMNS,
    HIGH_G_COLUMNS,
    HIGH_G_SUFFIX,
    NODE_COLUMNS,
    TABLE_FILE_COLUMNS,
    Recording,
    Table,
    split_high_g,
)

__all__ = ["Log", "LogMessage", "Stream", "open_log", "read_recording"]


def read_recording(path: Path, *, progress: Progress | None = None) -> Recording:
    """Read a whole MCAP file as `build_recording` does.

    Raises LogError if it is missing, empty or not MCAP; lesser damage is reported in `warnings`.
    """
    with open_log(path) as log:
        return build_recording(log, progress=progress)


def build_recording(
    source: MessageSource, selection: TopicSelection = SELECT_BY_TYPE, *, progress: Progress | None = None
) -> Recording:
    """Read a whole log into memory, each topic in the role that `assign_roles` gives it.

    The `temperature` and `supply` of a node come from their own topics, as recorded where each sample has
    one, else interpolated linearly. GNSS rows without a fix are omitted. Rows are sorted by time; of equal
    times the first is kept. For logs of other programs, `metadata["topics"]` lists the role of each topic and
    `warnings` the unused ones. Raises InputError as `assign_roles` does.
    """
    return _RecordingBuilder(source, selection, progress).build()


class _RecordingBuilder:
    """A builder that assembles the tables of a recording from the decoded messages of its log."""

    def __init__(self, log: MessageSource, selection: TopicSelection, progress: Progress | None) -> None:
        self.log, self.selection = log, selection
        self.decoded = DecodedLog(log, selection, progress)
        self.is_hubodo = is_hubodo_log(log)

    def _assign_roles(self) -> RoleAssignment:
        candidates = {
            topic: TopicCandidate(normalise_type_name(stream.schema))
            for topic, (stream, rows) in self.decoded.rows.items()
            if len(rows)
        }
        candidates |= {
            topic: TopicCandidate(ros2.JOINT_STATE, tuple(speeds.rows))
            for topic, speeds in self.decoded.joints.items()
        }
        return assign_roles(candidates, self.selection, is_hubodo=self.is_hubodo, log_name=str(self.log.path))

    def build(self) -> Recording:
        imported = self.log.metadata_records.get(topics.CSV_COLUMNS_RECORD, {})
        tables, roles = imported_tables(self.decoded, imported), self._assign_roles()
        for note in roles.notes:
            self.decoded.add_note(note)
        for name, topic in roles.nodes.items():
            if not (topic == topics.imu_topic(name) and name in imported and name in tables):
                tables[name if name not in tables else name + "_"] = self._node_table(topic)
        self._add_role_tables(tables, roles)
        self._add_high_g_tables(tables)
        tables, row_notes = drop_non_finite_rows(tables)
        for line in row_notes:
            self.decoded.add_note(line)
        magnetometers = {
            _topic_stem(topic): self.decoded.time_table(
                topic, rows, dict(zip("xyz", rows.values["magnetic_field"].T, strict=True)), "m"
            )
            for topic, (stream, rows) in self.decoded.rows.items()
            if normalise_type_name(stream.schema) == ros2.MAGNETIC_FIELD and len(rows)
        }
        bias_filters = {
            topic[1:].removesuffix("/bias_filter"): self._bias_filter_table(topic, rows)
            for topic, (_, rows) in self.decoded.rows.items()
            if topic == topics.bias_filter_topic(topic[1:].removesuffix("/bias_filter")) and len(rows)
        }
        tables, high_g = split_high_g(tables)
        special: dict[str, Any] = {name: tables.pop(name) for name in TABLE_FILE_COLUMNS if name in tables}
        metadata = dict(self.log.metadata)
        if not self.is_hubodo:
            used = {**roles.nodes, **{role: topic for role, topic in roles.files.items() if role in special}}
            metadata["topics"] = ", ".join(f"{name} = {topic}" for name, topic in used.items())
            self._note_unused_topics(set(used.values()))
        return Recording(
            tables,
            magnetometers=magnetometers,
            high_g=high_g,
            bias_filters={name: table for name, table in bias_filters.items() if table is not None},
            odometry=self._odometry_table(topics.ODOM),
            events=self.decoded.events,
            metadata=metadata,
            t_zero_ns=self.decoded.t_zero_ns,
            warnings=(*self.log.warnings(), *self.decoded.notes),
            **special,
        )

    def _note_unused_topics(self, used: set[str]) -> None:
        """Note the topics of another program's log that have no role."""
        used |= {_companion_topic(topic, what) for topic in used for what in _COMPANION_TOPICS}
        unused = [
            f"{stream.topic} ({normalise_type_name(stream.schema) or stream.encoding})"
            + (f" as {stream.encoding}" if stream.encoding != "cdr" and stream.schema else "")
            for stream in self.decoded.streams
            if (stream.topic not in used or stream.encoding != "cdr")
            and normalise_type_name(stream.schema) != ros2.MAGNETIC_FIELD
        ]
        if unused:
            self.decoded.add_note(f"not used: {', '.join(sorted(unused))}; --topic assigns a role to a topic")

    def _node_table(self, topic: str) -> Table:
        rows = self.decoded.rows[topic][1]
        values = np.hstack([rows.values["angular_velocity"], rows.values["linear_acceleration"]])
        table = self.decoded.time_table(topic, rows, dict(zip(NODE_COLUMNS[1:], values.T, strict=True)))
        columns = dict(table.columns)
        for what, (column, kind, value) in _COMPANION_TOPICS.items():
            reported = self.decoded.rows_of_type(_companion_topic(topic, what), kind)
            if reported is None:
                continue
            reported = reported.select(np.flatnonzero(np.isfinite(reported.values[value])))
            if len(reported):
                known = self.decoded.time_table("", reported, {column: reported.values[value]})
                columns[column] = np.interp(table.t, known.t, known[column])
        return Table(columns)

    def _bias_filter_table(self, topic: str, rows: ChannelRows) -> Table | None:
        columns = self.decoded.named_columns(topic, rows) if "data" in rows.values else {}
        if not set(BIAS_FILTER_COLUMNS[1:]) <= set(columns):
            self.decoded.add_note(f"{topic}: lacks the columns of a node's bias filter; left out")
            return None
        return self.decoded.time_table(topic, rows, columns)

    def _add_role_tables(self, tables: dict[str, Table], roles: RoleAssignment) -> None:
        """Add the tables of topics with a role, for logs that are not imports."""
        for role, topic in roles.files.items():
            if role not in tables:
                table = self._wheel_table(topic, roles) if role == "wheels" else self._role_table(role, topic)
                if table is not None and len(table):
                    tables[role] = table
        for topic in self.decoded.rows:
            name = topic.removeprefix(topics.COLUMNS_PREFIX)
            rows = self.decoded.rows_of_type(topic, ros2.FLOAT64_ARRAY)
            if (
                topic.startswith(topics.COLUMNS_PREFIX)
                and name in TABLE_FILE_COLUMNS
                and name not in tables
                and rows
            ):
                columns = self.decoded.named_columns(topic, rows)
                columns.pop("t", None)
                if set(TABLE_FILE_COLUMNS[name][0]) <= {"t", *columns}:
                    tables[name] = self.decoded.time_table(topic, rows, columns)

    def _add_high_g_tables(self, tables: dict[str, Table]) -> None:
        """Add the tables of second accelerometers, for logs that are not imports."""
        for topic in self.decoded.rows:
            columns_name = topic.removeprefix(topics.COLUMNS_PREFIX)
            name = columns_name.removeprefix(topics.HIGH_G_PREFIX) + HIGH_G_SUFFIX
            rows = self.decoded.rows_of_type(topic, ros2.FLOAT64_ARRAY)
            if topic == topics.COLUMNS_PREFIX + topics.columns_name(name) and name not in tables and rows:
                columns = self.decoded.named_columns(topic, rows)
                if set(HIGH_G_COLUMNS[1:]) <= set(columns):
                    tables[name] = self.decoded.time_table(topic, rows, columns)

    def _role_table(self, role: str, topic: str) -> Table:
        stream, rows = self.decoded.rows[topic]
        kind = normalise_type_name(stream.schema)
        if role == "gnss":
            return self.decoded.time_table(topic, *role_tables.gnss_columns(rows))
        if role == "heading":
            return self.decoded.time_table(topic, rows, role_tables.heading_columns(kind, rows, topic))
        columns = (
            role_tables.truth_columns(rows) if role == "truth" else role_tables.reference_columns(kind, rows)
        )
        return self.decoded.time_table(topic, rows, columns)

    def _wheel_table(self, topic: str, roles: RoleAssignment) -> Table | None:
        speeds, radius = self.decoded.joints[topic], self.selection.wheel_radius
        if speeds.undecodable:
            self.decoded.add_note(
                f"{speeds.undecodable} messages of {topic} do not match {ros2.JOINT_STATE}; left out"
            )
        if radius is None or roles.joints is None:
            self.decoded.add_note(
                f"{topic}: joint velocities of wheels are unused: their radius is missing; give --vehicle"
            )
            return None
        t_ns, columns = role_tables.wheel_speed_columns(speeds, roles.joints, radius)
        return Table({"t": to_seconds(t_ns, self.decoded.t_zero_ns), **columns})

    def _odometry_table(self, topic: str) -> Table | None:
        rows = self.decoded.rows_of_type(topic, ros2.ODOMETRY)
        if rows is None:
            return None
        return self.decoded.time_table(topic, rows, role_tables.odometry_columns(rows))


_COMPANION_TOPICS = {
    "temperature": ("temperature", ros2.TEMPERATURE, "temperature"),
    "battery": ("supply", ros2.BATTERY, "voltage"),
}
"""Companion topics of an IMU: name -> column of the node's table, message type and field."""


def _companion_topic(topic: str, quantity: str) -> str:
    """Return the topic of another quantity of the same node as an IMU topic."""
    return f"{topic.removesuffix('/imu')}/{quantity}"


def _topic_stem(topic: str) -> str:
    return topic.strip("/").rpartition("/")[0].replace("/", "_") or topic.strip("/")
