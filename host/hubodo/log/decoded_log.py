"""All messages of a log decoded: rows of each topic, wheel joints and events, with notes on what is lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hubodo.log import ros2, topics
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
from hubodo.log.roles import TopicSelection
from hubodo.log.source import MessageSource, Stream
from hubodo.log.timebase import to_seconds
from hubodo.progress_callback import Progress
from hubodo.recording import Table

EVENT_MEMORY_RATIO = 10
"""Bytes of memory per byte of an event's JSON, which becomes Python objects."""


class DecodedLog:
    """The decoded messages of a log.

    Attributes
    ----------
    streams
        The channels with messages.
    rows
        Channel and rows by topic, of the types in `TABLE_FIELDS`.
    joints
        Speeds of joints by topic.
    events
        Events in the order of the log.
    t_zero_ns
        Host time of t = 0.
    notes
        One line for each part that could not be decoded.
    """

    def __init__(self, log: MessageSource, selection: TopicSelection, progress: Progress | None) -> None:
        """Read and decode the whole log."""
        self._log, self._selection = log, selection
        budget = MemoryBudget(log.path)
        self.notes: list[str] = []
        payloads: list[bytes] = []
        decoders: dict[tuple[str, str], ChannelDecoder] = {}
        self.joints: dict[str, JointSpeeds] = {}
        counts: Counter[int] = Counter()
        unknown_channels: Counter[int] = Counter()
        for messages in log.chunks():
            streams = log.streams
            for id, chosen in messages.group_by_channel():
                stream = streams.get(id)
                if stream is None:
                    unknown_channels[id] += len(chosen)
                    continue
                kind = normalise_type_name(stream.schema)
                counts[id] += len(chosen)
                if stream.topic == topics.EVENTS:
                    budget.claim(
                        EVENT_MEMORY_RATIO * messages.total_record_size(chosen), "the list of its events"
                    )
                    payloads += [
                        decode_string_message(stream.encoding, messages.payload(i)) for i in chosen.tolist()
                    ]
                elif stream.encoding != "cdr":
                    continue
                elif kind == ros2.JOINT_STATE:
                    self.joints.setdefault(stream.topic, JointSpeeds(budget)).feed(messages, chosen)
                elif kind in TABLE_FIELDS:
                    key = (stream.topic, kind)
                    if key not in decoders:
                        decoders[key] = ChannelDecoder(kind, self._extra_fields(*key), budget)
                    decoders[key].feed(messages, chosen)
            if progress:
                progress(f"reading {log.path.name}", log.progress)
        for id, count in unknown_channels.items():
            self.add_note(f"{count} messages of unknown channel {id}; left out")
        self.streams = [log.streams[id] for id in counts]
        self.rows: dict[str, tuple[Stream, ChannelRows]] = {}
        for (topic, kind), decoder in decoders.items():
            stream = next(
                it for it in self.streams if (it.topic, normalise_type_name(it.schema)) == (topic, kind)
            )
            rows = decoder.rows()
            if rows.undecodable:
                self.add_note(
                    f"{rows.undecodable} messages of {topic} do not match {stream.schema}; left out"
                )
            self.rows.setdefault(topic, (stream, rows))
        self.events, unreadable = parse_events(payloads)
        for note in unreadable:
            self.add_note(note)
        self.t_zero_ns = self._find_t_zero()

    def _extra_fields(self, topic: str, kind: str) -> tuple[str, ...]:
        """Return the fields to decode additionally because of the role selected for a topic."""
        topic_by_role = {
            name: "/" + text.strip("/")
            for name, text in {**self._selection.configured, **self._selection.explicit}.items()
        }
        topic = "/" + topic.strip("/")
        is_heading = topic == topic_by_role.get("heading")
        if kind == ros2.IMU and is_heading:
            return ("orientation", "orientation_covariance")
        if kind == ros2.ODOMETRY and (is_heading or topic in (topic_by_role.get("truth"), topics.TRUTH)):
            return ("pose.covariance",)
        return ()

    def _find_t_zero(self) -> int:
        if self._log.t_zero_ns is not None:
            return self._log.t_zero_ns
        earliest = [int(rows.stamp_ns.min()) for _, rows in self.rows.values() if len(rows)]
        earliest += [t_ns for it in self.joints.values() for rows in it.rows.values() for t_ns, _ in rows[:1]]
        return min(earliest, default=0)

    def rows_of_type(self, topic: str, kind: str) -> ChannelRows | None:
        """Return the messages of a topic; None if it has none, or if they are of another type."""
        if topic not in self.rows or normalise_type_name(self.rows[topic][0].schema) != kind:
            return None
        return self.rows[topic][1] if len(self.rows[topic][1]) else None

    def named_columns(self, topic: str, rows: ChannelRows) -> dict[str, NDArray[np.float64]]:
        """Return the columns of a topic of number arrays by the names that the log gives them."""
        data = rows.values["data"]
        names = parse_column_names(self.rows[topic][0].metadata.get("columns", rows.label))
        if len(names) != data.shape[1]:
            names = [f"column{i}" for i in range(data.shape[1])]
        return dict(zip(names, data.T, strict=True))

    def time_table(
        self, topic: str, rows: ChannelRows, columns: Mapping[str, NDArray[np.float64]], prefix: str = ""
    ) -> Table:
        """Return columns by strictly increasing time; rows that repeat a time are omitted and noted."""
        t = to_seconds(rows.stamp_ns, self.t_zero_ns)
        chosen = np.unique(t, return_index=True)[1]
        if topic and len(chosen) < len(t):
            self.add_note(f"{len(t) - len(chosen)} messages of {topic} repeat the time of another; left out")
        return Table({"t": t[chosen], **{prefix + name: values[chosen] for name, values in columns.items()}})

    def add_note(self, text: str) -> None:
        """Add a note about the log."""
        self.notes.append(f"{self._log.path}: {text}")
