"""Build a recording from the messages of a log: hubodo's own losslessly, others by the role of each topic."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.log import role_tables, ros2, topics
from hubodo.log.decode import (
    TABLE_FIELDS,
    ChannelDecoder,
    ChannelRows,
    normalise_type_name,
    parse_column_names,
)
from hubodo.log.hubodo_messages import decode_string_message, parse_events
from hubodo.log.input_limits import MemoryBudget
from hubodo.log.joints import JointSpeeds
from hubodo.log.logfile import Log, LogMessage, open_log
from hubodo.log.recording_writer import lossless_ros_columns
from hubodo.log.roles import SELECT_BY_TYPE, RoleAssignment, TopicCandidate, TopicSelection, assign_roles
from hubodo.log.row_checks import drop_non_finite_rows
from hubodo.log.row_matching import first_row_at_each_time, match_sequences, rows_of_sequences
from hubodo.log.source import MessageSource, Stream, is_hubodo_log
from hubodo.log.timebase import MAX_EXACT_S, to_seconds
from hubodo.recording import BIAS_FILTER_COLUMNS, NODE_COLUMNS, TABLE_FILE_COLUMNS, Recording, Table
from hubodo.units import NS_PER_S

__all__ = ["Log", "LogMessage", "Stream", "open_log", "read_recording"]

Progress = Callable[[str, float], None]
EVENT_MEMORY_RATIO = 10
"""Bytes of memory per byte of an event's JSON, which becomes Python objects."""


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
    """A builder that decodes all channels of a log into rows and assembles the tables."""

    def __init__(self, log: MessageSource, selection: TopicSelection, progress: Progress | None) -> None:
        self.log, self.selection = log, selection
        self.budget = MemoryBudget(log.path)
        self.notes: list[str] = []
        payloads: list[bytes] = []
        decoders: dict[tuple[str, str], ChannelDecoder] = {}
        self.joints: dict[str, JointSpeeds] = {}
        self.counts: Counter[int] = Counter()
        unknown_channels: Counter[int] = Counter()
        for messages in log.chunks():
            streams = log.streams
            for id, chosen in messages.group_by_channel():
                stream = streams.get(id)
                if stream is None:
                    unknown_channels[id] += len(chosen)
                    continue
                kind = normalise_type_name(stream.schema)
                self.counts[id] += len(chosen)
                if stream.topic == topics.EVENTS:
                    self.budget.claim(
                        EVENT_MEMORY_RATIO * messages.total_record_size(chosen), "the list of its events"
                    )
                    payloads += [
                        decode_string_message(stream.encoding, messages.payload(i)) for i in chosen.tolist()
                    ]
                elif stream.encoding != "cdr":
                    continue
                elif kind == ros2.JOINT_STATE:
                    self.joints.setdefault(stream.topic, JointSpeeds(self.budget)).feed(messages, chosen)
                elif kind in TABLE_FIELDS:
                    key = (stream.topic, kind)
                    if key not in decoders:
                        decoders[key] = ChannelDecoder(kind, self._extra_fields(*key), self.budget)
                    decoders[key].feed(messages, chosen)
            if progress:
                progress(f"reading {log.path.name}", log.progress)
        for id, count in unknown_channels.items():
            self._add_note(f"{count} messages of unknown channel {id}; left out")
        self.is_hubodo = is_hubodo_log(log)
        self.streams = [log.streams[id] for id in self.counts]
        self.rows: dict[str, tuple[Stream, ChannelRows]] = {}
        for (topic, kind), decoder in decoders.items():
            stream = next(
                it for it in self.streams if (it.topic, normalise_type_name(it.schema)) == (topic, kind)
            )
            rows = decoder.rows()
            if rows.undecodable:
                self._add_note(
                    f"{rows.undecodable} messages of {topic} do not match {stream.schema}; left out"
                )
            self.rows.setdefault(topic, (stream, rows))
        self.events, unreadable = parse_events(payloads)
        for note in unreadable:
            self._add_note(note)
        self.t_zero_ns = self._find_t_zero()

    def _extra_fields(self, topic: str, kind: str) -> tuple[str, ...]:
        """Return the fields to decode additionally because of the role selected for a topic."""
        topic_by_role = {
            name: "/" + text.strip("/")
            for name, text in {**self.selection.configured, **self.selection.explicit}.items()
        }
        topic = "/" + topic.strip("/")
        is_heading = topic == topic_by_role.get("heading")
        if kind == ros2.IMU and is_heading:
            return ("orientation", "orientation_covariance")
        if kind == ros2.ODOMETRY and (is_heading or topic in (topic_by_role.get("truth"), topics.TRUTH)):
            return ("pose.covariance",)
        return ()

    def _add_note(self, text: str) -> None:
        self.notes.append(f"{self.log.path}: {text}")

    def _find_t_zero(self) -> int:
        if self.log.t_zero_ns is not None:
            return self.log.t_zero_ns
        earliest = [int(rows.stamp_ns.min()) for _, rows in self.rows.values() if len(rows)]
        earliest += [t_ns for it in self.joints.values() for rows in it.rows.values() for t_ns, _ in rows[:1]]
        return min(earliest, default=0)

    def _assign_roles(self) -> RoleAssignment:
        candidates = {
            topic: TopicCandidate(normalise_type_name(stream.schema))
            for topic, (stream, rows) in self.rows.items()
            if len(rows)
        }
        candidates |= {
            topic: TopicCandidate(ros2.JOINT_STATE, tuple(speeds.rows))
            for topic, speeds in self.joints.items()
        }
        return assign_roles(candidates, self.selection, is_hubodo=self.is_hubodo, log_name=str(self.log.path))

    def build(self) -> Recording:
        tables, roles = self._imported_tables(), self._assign_roles()
        for note in roles.notes:
            self._add_note(note)
        imported = self.log.metadata_records.get(topics.CSV_COLUMNS_RECORD, {})
        for name, topic in roles.nodes.items():
            if not (topic == topics.imu_topic(name) and name in imported and name in tables):
                tables[name if name not in tables else name + "_"] = self._node_table(topic)
        self._add_role_tables(tables, roles)
        tables, row_notes = drop_non_finite_rows(tables)
        for line in row_notes:
            self._add_note(line)
        magnetometers = {
            _topic_stem(topic): self._time_table(
                topic, rows, dict(zip("xyz", rows.values["magnetic_field"].T, strict=True)), "m"
            )
            for topic, (stream, rows) in self.rows.items()
            if normalise_type_name(stream.schema) == ros2.MAGNETIC_FIELD and len(rows)
        }
        bias_filters = {
            topic[1:].removesuffix("/bias_filter"): self._bias_filter_table(topic, rows)
            for topic, (_, rows) in self.rows.items()
            if topic == topics.bias_filter_topic(topic[1:].removesuffix("/bias_filter")) and len(rows)
        }
        special: dict[str, Any] = {name: tables.pop(name) for name in TABLE_FILE_COLUMNS if name in tables}
        metadata = dict(self.log.metadata)
        if not self.is_hubodo:
            used = {**roles.nodes, **{role: topic for role, topic in roles.files.items() if role in special}}
            metadata["topics"] = ", ".join(f"{name} = {topic}" for name, topic in used.items())
            self._note_unused_topics(set(used.values()))
        return Recording(
            tables,
            magnetometers=magnetometers,
            bias_filters={name: table for name, table in bias_filters.items() if table is not None},
            odometry=self._odometry_table(topics.ODOM),
            events=self.events,
            metadata=metadata,
            t_zero_ns=self.t_zero_ns,
            warnings=(*self.log.warnings(), *self.notes),
            **special,
        )

    def _note_unused_topics(self, used: set[str]) -> None:
        """Note the topics of another program's log that have no role."""
        used |= {_companion_topic(topic, what) for topic in used for what in _COMPANION_TOPICS}
        unused = [
            f"{stream.topic} ({normalise_type_name(stream.schema) or stream.encoding})"
            + (f" as {stream.encoding}" if stream.encoding != "cdr" and stream.schema else "")
            for stream in self.streams
            if (stream.topic not in used or stream.encoding != "cdr")
            and normalise_type_name(stream.schema) != ros2.MAGNETIC_FIELD
        ]
        if unused:
            self._add_note(f"not used: {', '.join(sorted(unused))}; --topic assigns a role to a topic")

    def _imported_tables(self) -> dict[str, Table]:
        """Return the tables of an imported log, each row joined from its channels by sequence number."""
        tables = {}
        for name, text in self.log.metadata_records.get(topics.CSV_COLUMNS_RECORD, {}).items():
            columns = parse_column_names(text)
            if "t" not in columns:
                self._add_note(f"{name}: its list of columns is damaged; read by topic instead")
                continue
            parts = self._channel_parts(name, columns)
            if not parts:
                tables[name] = Table({column: np.empty(0) for column in columns})
                continue
            common, lost = match_sequences([rows.sequence for rows, _ in parts])
            if lost:
                self._add_note(f"{name}: {lost} rows are incomplete because of damage; left out")
            since_zero_ns = (
                parts[0][0].stamp_ns[rows_of_sequences(parts[0][0].sequence, common)] - self.t_zero_ns
            )
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
                self._add_note(f"{name}: column {', '.join(absent)} is lost")
            increasing = first_row_at_each_time(values_by_column["t"])
            repeated = len(since_zero_ns) - len(since_zero_ns[increasing])
            if repeated:
                self._add_note(f"{name}: {repeated} rows repeat the time of another; left out")
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
        self, name: str, columns: list[str]
    ) -> list[tuple[ChannelRows, dict[str, NDArray[np.float64]]]]:
        parts = []
        if (imu := self._rows_of_type(topics.imu_topic(name), ros2.IMU)) and lossless_ros_columns(name)[
            0
        ] == "gx":
            names = NODE_COLUMNS[1:]
            stacked = np.hstack([imu.values["angular_velocity"], imu.values["linear_acceleration"]])
            parts.append((imu, dict(zip(names, stacked.T, strict=True))))
            temperature = self._rows_of_type(topics.temperature_topic(name), ros2.TEMPERATURE)
            if "temperature" in columns and temperature:
                parts.append((temperature, {"temperature": temperature.values["temperature"]}))
        if name == "gnss" and (fix := self._rows_of_type(topics.GNSS_FIX, ros2.NAV_SAT_FIX)):
            parts.append((fix, role_tables.position_columns(fix)))
        if name == "truth" and (truth := self._rows_of_type(topics.TRUTH, ros2.ODOMETRY)):
            position = truth.values["pose.pose.position"]
            parts.append((truth, {"x": position[:, 0], "y": position[:, 1]}))
        if others := self._rows_of_type(topics.COLUMNS_PREFIX + name, ros2.FLOAT64_ARRAY):
            parts.append((others, self._named_columns(topics.COLUMNS_PREFIX + name, others)))
        return parts

    def _rows_of_type(self, topic: str, kind: str) -> ChannelRows | None:
        """Return the messages of a topic; None if it has none, or if they are of another type."""
        if topic not in self.rows or normalise_type_name(self.rows[topic][0].schema) != kind:
            return None
        return self.rows[topic][1] if len(self.rows[topic][1]) else None

    def _named_columns(self, topic: str, rows: ChannelRows) -> dict[str, NDArray[np.float64]]:
        data = rows.values["data"]
        names = parse_column_names(self.rows[topic][0].metadata.get("columns", rows.label))
        if len(names) != data.shape[1]:
            names = [f"column{i}" for i in range(data.shape[1])]
        return dict(zip(names, data.T, strict=True))

    def _node_table(self, topic: str) -> Table:
        rows = self.rows[topic][1]
        values = np.hstack([rows.values["angular_velocity"], rows.values["linear_acceleration"]])
        table = self._time_table(topic, rows, dict(zip(NODE_COLUMNS[1:], values.T, strict=True)))
        columns = dict(table.columns)
        for what, (column, kind, value) in _COMPANION_TOPICS.items():
            reported = self._rows_of_type(_companion_topic(topic, what), kind)
            if reported is None:
                continue
            reported = reported.select(np.flatnonzero(np.isfinite(reported.values[value])))
            if len(reported):
                known = self._time_table("", reported, {column: reported.values[value]})
                columns[column] = np.interp(table.t, known.t, known[column])
        return Table(columns)

    def _bias_filter_table(self, topic: str, rows: ChannelRows) -> Table | None:
        columns = self._named_columns(topic, rows) if "data" in rows.values else {}
        if not set(BIAS_FILTER_COLUMNS[1:]) <= set(columns):
            self._add_note(f"{topic}: lacks the columns of a node's bias filter; left out")
            return None
        return self._time_table(topic, rows, columns)

    def _add_role_tables(self, tables: dict[str, Table], roles: RoleAssignment) -> None:
        """Add the tables of topics with a role, for logs that are not imports."""
        for role, topic in roles.files.items():
            if role not in tables:
                table = self._wheel_table(topic, roles) if role == "wheels" else self._role_table(role, topic)
                if table is not None and len(table):
                    tables[role] = table
        for topic in self.rows:
            name = topic.removeprefix(topics.COLUMNS_PREFIX)
            rows = self._rows_of_type(topic, ros2.FLOAT64_ARRAY)
            if (
                topic.startswith(topics.COLUMNS_PREFIX)
                and name in TABLE_FILE_COLUMNS
                and name not in tables
                and rows
            ):
                columns = self._named_columns(topic, rows)
                columns.pop("t", None)
                if set(TABLE_FILE_COLUMNS[name][0]) <= {"t", *columns}:
                    tables[name] = self._time_table(topic, rows, columns)

    def _role_table(self, role: str, topic: str) -> Table:
        stream, rows = self.rows[topic]
        kind = normalise_type_name(stream.schema)
        if role == "gnss":
            return self._time_table(topic, *role_tables.gnss_columns(rows))
        if role == "heading":
            return self._time_table(topic, rows, role_tables.heading_columns(kind, rows, topic))
        columns = (
            role_tables.truth_columns(rows) if role == "truth" else role_tables.reference_columns(kind, rows)
        )
        return self._time_table(topic, rows, columns)

    def _wheel_table(self, topic: str, roles: RoleAssignment) -> Table | None:
        speeds, radius = self.joints[topic], self.selection.wheel_radius
        if speeds.undecodable:
            self._add_note(
                f"{speeds.undecodable} messages of {topic} do not match {ros2.JOINT_STATE}; left out"
            )
        if radius is None or roles.joints is None:
            self._add_note(
                f"{topic}: joint velocities of wheels are unused: their radius is missing; give --vehicle"
            )
            return None
        t_ns, columns = role_tables.wheel_speed_columns(speeds, roles.joints, radius)
        return Table({"t": to_seconds(t_ns, self.t_zero_ns), **columns})

    def _odometry_table(self, topic: str) -> Table | None:
        rows = self._rows_of_type(topic, ros2.ODOMETRY)
        if rows is None:
            return None
        return self._time_table(topic, rows, role_tables.odometry_columns(rows))

    def _time_table(
        self, topic: str, rows: ChannelRows, columns: Mapping[str, NDArray[np.float64]], prefix: str = ""
    ) -> Table:
        """Return columns by strictly increasing time; rows that repeat a time are omitted and noted."""
        t = to_seconds(rows.stamp_ns, self.t_zero_ns)
        chosen = np.unique(t, return_index=True)[1]
        if topic and len(chosen) < len(t):
            self._add_note(f"{len(t) - len(chosen)} messages of {topic} repeat the time of another; left out")
        return Table({"t": t[chosen], **{prefix + name: values[chosen] for name, values in columns.items()}})


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
