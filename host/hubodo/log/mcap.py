"""Messages to a recording in memory: ours to the last bit, those of others by what they are said to be."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.log import role_tables, ros2, topics
from hubodo.log.claims import MemoryBudget
from hubodo.log.convert import carried_columns
from hubodo.log.decode import WANTED, ChannelRows, Decoder, column_names, message_type
from hubodo.log.joints import JointSpeeds
from hubodo.log.logfile import Log, LogMessage, open_log
from hubodo.log.meeting_rows import places_of, rising_rows, shared_rows
from hubodo.log.own_messages import own_text
from hubodo.log.roles import BY_TYPE, Roles, RoleTopic, TopicChoice, assign
from hubodo.log.sound_rows import sound_tables
from hubodo.log.source import Source, Stream, is_ours
from hubodo.log.timebase import EXACT_S, to_seconds
from hubodo.recording import BIAS_FILTER_COLUMNS, NODE_COLUMNS, TABLE_FILE_COLUMNS, Event, Recording, Table
from hubodo.units import NS_PER_S

__all__ = ["Log", "LogMessage", "Stream", "open_log", "read_recording"]

Progress = Callable[[str, float], None]
EVENT_MEMORY = 10
"""Bytes of memory per byte of an event's JSON, which becomes Python objects."""


def read_recording(path: Path, *, progress: Progress | None = None) -> Recording:
    """Read a whole MCAP file as `recording_of` does.

    Raises LogError when it is missing, empty or no MCAP; all lesser damage stands in `warnings`.
    """
    with open_log(path) as log:
        return recording_of(log, progress=progress)


def recording_of(
    source: Source, choice: TopicChoice = BY_TYPE, *, progress: Progress | None = None
) -> Recording:
    """Read a whole log into memory, each topic as what `roles.assign` takes it for.

    A node's `temperature` and `supply` are those of their topics: as recorded where each sample has one, else
    interpolated linearly. GNSS rows without a fix are left out. Rows are put in order of time; of equal times
    the first stays. `metadata["topics"]` tells what a foreign log is taken for topic by topic, `warnings`
    what is not. Raises InputError as `assign` does.
    """
    return _Collected(source, choice, progress).recording()


def events_of(payloads: Iterable[bytes]) -> tuple[tuple[Event, ...], tuple[str, ...]]:
    """Events in order of time from their messages, and a note on each that cannot be understood."""
    events, notes = [], []
    for payload in payloads:
        try:
            body = json.loads(payload, parse_constant=_no_number, parse_float=_finite)
            events.append(
                Event(
                    int(body["t_ns"]),
                    str(body["kind"]),
                    str(body["source"]),
                    str(body["text"]),
                    dict(body["data"]),
                )
            )
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            notes.append(f"an event cannot be understood: {payload[:60]!r}")
    return tuple(sorted(events, key=lambda event: event.t_ns)), tuple(notes)


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number of JSON")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _no_number(text)


class _Collected:
    """All channels of a log as rows, and the tables made of them."""

    def __init__(self, log: Source, choice: TopicChoice, progress: Progress | None) -> None:
        self.log, self.choice = log, choice
        self.budget = MemoryBudget(log.path)
        self.notes: list[str] = []
        payloads: list[bytes] = []
        decoders: dict[tuple[str, str], Decoder] = {}
        self.joints: dict[str, JointSpeeds] = {}
        self.counts: Counter[int] = Counter()
        strangers: Counter[int] = Counter()
        for messages in log.chunks():
            streams = log.streams
            for id, chosen in messages.by_channel():
                stream = streams.get(id)
                if stream is None:
                    strangers[id] += len(chosen)
                    continue
                kind = message_type(stream.schema)
                self.counts[id] += len(chosen)
                if stream.topic == topics.EVENTS:
                    self.budget.claim(EVENT_MEMORY * messages.size_of(chosen), "the list of its events")
                    payloads += [own_text(stream.encoding, messages.payload(i)) for i in chosen.tolist()]
                elif stream.encoding != "cdr":
                    continue
                elif kind == ros2.JOINT_STATE:
                    self.joints.setdefault(stream.topic, JointSpeeds(self.budget)).feed(messages, chosen)
                elif kind in WANTED:
                    key = (stream.topic, kind)
                    if key not in decoders:
                        decoders[key] = Decoder(kind, self._more(*key), self.budget)
                    decoders[key].feed(messages, chosen)
            if progress:
                progress(f"reading {log.path.name}", log.progress)
        for id, count in strangers.items():
            self._note(f"{count} messages of unknown channel {id} are left out")
        self.ours = is_ours(log)
        self.streams = [log.streams[id] for id in self.counts]
        self.rows: dict[str, tuple[Stream, ChannelRows]] = {}
        for (topic, kind), decoder in decoders.items():
            stream = next(it for it in self.streams if (it.topic, message_type(it.schema)) == (topic, kind))
            rows = decoder.rows()
            if rows.undecodable:
                self._note(f"{rows.undecodable} messages of {topic} do not fit {stream.schema}; left out")
            self.rows.setdefault(topic, (stream, rows))
        self.events, misunderstood = events_of(payloads)
        for note in misunderstood:
            self._note(note)
        self.t_zero_ns = self._zero()

    def _more(self, topic: str, kind: str) -> tuple[str, ...]:
        """What else is wanted of a topic's messages, for the role that it is said to play."""
        said = {
            name: "/" + text.strip("/") for name, text in {**self.choice.known, **self.choice.said}.items()
        }
        topic = "/" + topic.strip("/")
        is_heading = topic == said.get("heading")
        if kind == ros2.IMU and is_heading:
            return ("orientation", "orientation_covariance")
        if kind == ros2.ODOMETRY and (is_heading or topic in (said.get("truth"), topics.TRUTH)):
            return ("pose.covariance",)
        return ()

    def _note(self, text: str) -> None:
        self.notes.append(f"{self.log.path}: {text}")

    def _zero(self) -> int:
        if self.log.t_zero_ns is not None:
            return self.log.t_zero_ns
        earliest = [int(rows.stamp_ns.min()) for _, rows in self.rows.values() if len(rows)]
        earliest += [t_ns for it in self.joints.values() for rows in it.rows.values() for t_ns, _ in rows[:1]]
        return min(earliest, default=0)

    def _roles(self) -> Roles:
        found = {
            topic: RoleTopic(message_type(stream.schema))
            for topic, (stream, rows) in self.rows.items()
            if len(rows)
        }
        found |= {
            topic: RoleTopic(ros2.JOINT_STATE, tuple(speeds.rows)) for topic, speeds in self.joints.items()
        }
        return assign(found, self.choice, ours=self.ours, where=str(self.log.path))

    def recording(self) -> Recording:
        tables, roles = self._csv_files(), self._roles()
        for note in roles.notes:
            self._note(note)
        imported = self.log.records.get(topics.CSV_FILES, {})
        for name, topic in roles.nodes.items():
            if not (topic == topics.imu(name) and name in imported and name in tables):
                tables[name if name not in tables else name + "_"] = self._live_node(topic)
        self._live_files(tables, roles)
        tables, unsound = sound_tables(tables)
        for line in unsound:
            self._note(line)
        magnetometers = {
            _stem(topic): self._ordered(
                topic, rows, dict(zip("xyz", rows.values["magnetic_field"].T, strict=True)), "m"
            )
            for topic, (stream, rows) in self.rows.items()
            if message_type(stream.schema) == ros2.MAGNETIC_FIELD and len(rows)
        }
        bias_filters = {
            topic[1:].removesuffix("/bias_filter"): self._bias_filter(topic, rows)
            for topic, (_, rows) in self.rows.items()
            if topic == topics.bias_filter(topic[1:].removesuffix("/bias_filter")) and len(rows)
        }
        special: dict[str, Any] = {name: tables.pop(name) for name in TABLE_FILE_COLUMNS if name in tables}
        metadata = dict(self.log.metadata)
        if not self.ours:
            used = {**roles.nodes, **{role: topic for role, topic in roles.files.items() if role in special}}
            metadata["topics"] = ", ".join(f"{name} = {topic}" for name, topic in used.items())
            self._tell_unused(set(used.values()))
        return Recording(
            tables,
            magnetometers=magnetometers,
            bias_filters={name: table for name, table in bias_filters.items() if table is not None},
            odometry=self._odometry(topics.ODOM),
            events=self.events,
            metadata=metadata,
            t_zero_ns=self.t_zero_ns,
            warnings=(*self.log.warnings(), *self.notes),
            **special,
        )

    def _tell_unused(self, used: set[str]) -> None:
        """What is in a foreign log and plays no part."""
        used |= {_beside(topic, what) for topic in used for what in _TOLD_BESIDE}
        unused = [
            f"{stream.topic} ({message_type(stream.schema) or stream.encoding})"
            + (f" as {stream.encoding}" if stream.encoding != "cdr" and stream.schema else "")
            for stream in self.streams
            if (stream.topic not in used or stream.encoding != "cdr")
            and message_type(stream.schema) != ros2.MAGNETIC_FIELD
        ]
        if unused:
            self._note(f"not used: {', '.join(sorted(unused))}; --topic says what a topic is")

    def _csv_files(self) -> dict[str, Table]:
        """The files of an import, each row put together from its messages by sequence number."""
        tables = {}
        for name, text in self.log.records.get(topics.CSV_FILES, {}).items():
            columns = column_names(text)
            if "t" not in columns:
                self._note(f"{name}: its list of columns is damaged; read by topic instead")
                continue
            parts = self._parts_of(name, columns)
            if not parts:
                tables[name] = Table({column: np.empty(0) for column in columns})
                continue
            common, lost = shared_rows([rows.sequence for rows, _ in parts])
            if lost:
                self._note(f"{name}: {lost} rows have lost a part to damage; left out")
            since = parts[0][0].stamp_ns[places_of(parts[0][0].sequence, common)] - self.t_zero_ns
            found = {"t": to_seconds(since, 0)}
            for rows, values in parts:
                chosen = places_of(rows.sequence, common)
                found.update({column: array[chosen] for column, array in values.items()})
            between = any("t" in values for _, values in parts)
            beyond = len(since) > 0 and int(np.abs(since).max()) >= EXACT_S * NS_PER_S and not between
            if absent := [column for column in columns if column not in found]:
                self._note(f"{name}: nothing is left of column {', '.join(absent)}")
            rising = rising_rows(found["t"])
            repeated = len(since) - len(since[rising])
            if repeated:
                self._note(f"{name}: {repeated} rows repeat the time of another; left out")
            tables[name] = Table(
                {column: found[column][rising] for column in columns if column in found},
                since[rising] if beyond else None,
            )
        return tables

    def _parts_of(
        self, name: str, columns: list[str]
    ) -> list[tuple[ChannelRows, dict[str, NDArray[np.float64]]]]:
        parts = []
        if (imu := self._get(topics.imu(name), ros2.IMU)) and carried_columns(name)[0] == "gx":
            names = NODE_COLUMNS[1:]
            stacked = np.hstack([imu.values["angular_velocity"], imu.values["linear_acceleration"]])
            parts.append((imu, dict(zip(names, stacked.T, strict=True))))
            heat = self._get(topics.temperature(name), ros2.TEMPERATURE)
            if "temperature" in columns and heat:
                parts.append((heat, {"temperature": heat.values["temperature"]}))
        if name == "gnss" and (fix := self._get(topics.FIX, ros2.NAV_SAT_FIX)):
            parts.append((fix, role_tables.position(fix)))
        if name == "truth" and (truth := self._get(topics.TRUTH, ros2.ODOMETRY)):
            position = truth.values["pose.pose.position"]
            parts.append((truth, {"x": position[:, 0], "y": position[:, 1]}))
        if rest := self._get(topics.COLUMNS + name, ros2.COLUMNS):
            parts.append((rest, self._columns(topics.COLUMNS + name, rest)))
        return parts

    def _get(self, topic: str, kind: str) -> ChannelRows | None:
        """Return the messages of a topic; None where it has none, or those of another type."""
        if topic not in self.rows or message_type(self.rows[topic][0].schema) != kind:
            return None
        return self.rows[topic][1] if len(self.rows[topic][1]) else None

    def _columns(self, topic: str, rows: ChannelRows) -> dict[str, NDArray[np.float64]]:
        data = rows.values["data"]
        names = column_names(self.rows[topic][0].metadata.get("columns", rows.label))
        if len(names) != data.shape[1]:
            names = [f"column{i}" for i in range(data.shape[1])]
        return dict(zip(names, data.T, strict=True))

    def _live_node(self, topic: str) -> Table:
        rows = self.rows[topic][1]
        values = np.hstack([rows.values["angular_velocity"], rows.values["linear_acceleration"]])
        table = self._ordered(topic, rows, dict(zip(NODE_COLUMNS[1:], values.T, strict=True)))
        columns = dict(table.columns)
        for what, (column, kind, value) in _TOLD_BESIDE.items():
            reported = self._get(_beside(topic, what), kind)
            if reported is None:
                continue
            reported = reported.take(np.flatnonzero(np.isfinite(reported.values[value])))
            if len(reported):
                known = self._ordered("", reported, {column: reported.values[value]})
                columns[column] = np.interp(table.t, known.t, known[column])
        return Table(columns)

    def _bias_filter(self, topic: str, rows: ChannelRows) -> Table | None:
        columns = self._columns(topic, rows) if "data" in rows.values else {}
        if not set(BIAS_FILTER_COLUMNS[1:]) <= set(columns):
            self._note(f"{topic}: is not what a node's filter says; left out")
            return None
        return self._ordered(topic, rows, columns)

    def _live_files(self, tables: dict[str, Table], roles: Roles) -> None:
        """The files of the CSV folder, of logs that are no import."""
        for role, topic in roles.files.items():
            if role not in tables:
                table = self._wheels(topic, roles) if role == "wheels" else self._file(role, topic)
                if table is not None and len(table):
                    tables[role] = table
        for topic in self.rows:
            name = topic.removeprefix(topics.COLUMNS)
            rows = self._get(topic, ros2.COLUMNS)
            if (
                topic.startswith(topics.COLUMNS)
                and name in TABLE_FILE_COLUMNS
                and name not in tables
                and rows
            ):
                columns = self._columns(topic, rows)
                columns.pop("t", None)
                if set(TABLE_FILE_COLUMNS[name][0]) <= {"t", *columns}:
                    tables[name] = self._ordered(topic, rows, columns)

    def _file(self, role: str, topic: str) -> Table:
        stream, rows = self.rows[topic]
        kind = message_type(stream.schema)
        if role == "gnss":
            return self._ordered(topic, *role_tables.gnss(rows))
        if role == "heading":
            return self._ordered(topic, rows, role_tables.heading(kind, rows, topic))
        columns = role_tables.truth(rows) if role == "truth" else role_tables.reference(kind, rows)
        return self._ordered(topic, rows, columns)

    def _wheels(self, topic: str, roles: Roles) -> Table | None:
        speeds, radius = self.joints[topic], self.choice.wheel_radius
        if speeds.undecodable:
            self._note(f"{speeds.undecodable} messages of {topic} do not fit {ros2.JOINT_STATE}; left out")
        if radius is None or roles.joints is None:
            self._note(f"{topic}: angular speeds of wheels; their radius is missing, --vehicle tells it")
            return None
        t_ns, columns = role_tables.wheels(speeds, roles.joints, radius)
        return Table({"t": to_seconds(t_ns, self.t_zero_ns), **columns})

    def _odometry(self, topic: str) -> Table | None:
        rows = self._get(topic, ros2.ODOMETRY)
        if rows is None:
            return None
        return self._ordered(topic, rows, role_tables.odometry(rows))

    def _ordered(
        self, topic: str, rows: ChannelRows, columns: Mapping[str, NDArray[np.float64]], prefix: str = ""
    ) -> Table:
        """Columns by time, strictly increasing; rows that repeat a time are left out and noted."""
        t = to_seconds(rows.stamp_ns, self.t_zero_ns)
        chosen = np.unique(t, return_index=True)[1]
        if topic and len(chosen) < len(t):
            self._note(f"{len(t) - len(chosen)} messages of {topic} repeat the time of another; left out")
        return Table({"t": t[chosen], **{prefix + name: values[chosen] for name, values in columns.items()}})


_TOLD_BESIDE = {
    "temperature": ("temperature", ros2.TEMPERATURE, "temperature"),
    "battery": ("supply", ros2.BATTERY, "voltage"),
}
"""Topics beside that of an IMU: name -> column of the node's table, the message's type and field."""


def _beside(topic: str, what: str) -> str:
    """Where something else is told of an IMU."""
    return f"{topic.removesuffix('/imu')}/{what}"


def _stem(topic: str) -> str:
    return topic.strip("/").rpartition("/")[0].replace("/", "_") or topic.strip("/")
