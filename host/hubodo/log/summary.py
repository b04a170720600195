"""Summarise a log: streams, measured rates, gaps and their causes, events, health, metadata."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.log import ros2, topics
from hubodo.log.chunk_reader import ChunkMessages
from hubodo.log.decode import ChannelDecoder, header_stamps, normalise_type_name, parse_column_names
from hubodo.log.decoded_log import EVENT_MEMORY_RATIO
from hubodo.log.gap_causes import LossTotal, last_health_reports, sum_losses
from hubodo.log.hubodo_messages import decode_string_message, parse_events
from hubodo.log.input_limits import MemoryBudget
from hubodo.log.joints import JointSpeeds
from hubodo.log.logfile import open_log
from hubodo.log.roles import SELECT_BY_TYPE, TopicCandidate, TopicSelection, assign_roles
from hubodo.log.source import MessageSource, Stream, is_hubodo_log
from hubodo.log.stream_summary import SampleGap, StreamSummary, summarise_stream
from hubodo.progress_callback import Progress
from hubodo.recording import BIAS_FILTER_COLUMNS, Event


@dataclass(frozen=True)
class Summary:
    """The content of `hubodo info`.

    Attributes
    ----------
    start_ns : host time of t = 0.
    duration : s between first and last message.
    health : last health report of each node.
    bias_filters : last report of each node's bias filter, columns `BIAS_FILTER_COLUMNS`.
    roles : role of each topic of another program's log: node or table name -> topic.
    attachments : size of each attached file, bytes.
    damaged : number of damaged parts and failed checksums.
    """

    path: Path
    size: int
    library: str
    profile: str
    complete: bool
    start_ns: int
    duration: float
    streams: tuple[StreamSummary, ...]
    events: tuple[Event, ...]
    losses: tuple[LossTotal, ...]
    health: Mapping[str, Mapping[str, Any]]
    bias_filters: Mapping[str, Mapping[str, float]]
    metadata: Mapping[str, str]
    roles: Mapping[str, str]
    attachments: Mapping[str, int]
    damaged: int
    warnings: tuple[str, ...]

    @property
    def gaps(self) -> tuple[SampleGap, ...]:
        """The gaps of all streams, sorted by time."""
        return tuple(sorted((gap for s in self.streams for gap in s.gaps), key=lambda gap: gap.t))

    def seconds(self, t_ns: int) -> float:
        """Convert host time in ns to seconds since t = 0."""
        return (t_ns - self.start_ns) / 1e9


def summarise(path: Path, *, progress: Progress | None = None) -> Summary:
    """Read an MCAP file once and summarise it. Raises LogError if it is missing, empty or not MCAP."""
    with open_log(path) as log:
        return summarise_source(log, progress=progress)


def summarise_source(
    source: MessageSource, selection: TopicSelection = SELECT_BY_TYPE, *, progress: Progress | None = None
) -> Summary:
    """Read a log once and summarise it. selection: the user's selection of topics.

    Raises InputError for a --topic that is missing or of another type.
    """
    contents = _read_contents(source, progress)
    events, notes = parse_events(contents.event_payloads)
    roles, role_notes = _suggest_roles(source, contents, selection)
    message_counts: Counter[str] = Counter()
    for id, (log_ns, _) in contents.times.items():
        message_counts[source.streams[id].topic] += len(log_ns)
    notes = (
        *notes,
        *role_notes,
        *(
            _describe_non_finite(topic, field, count, message_counts[topic])
            for (topic, field), count in contents.non_finite_counts.items()
        ),
    )
    first = min((int(log_ns.min()) for log_ns, _ in contents.times.values()), default=0)
    last = max((int(log_ns.max()) for log_ns, _ in contents.times.values()), default=0)
    start = source.t_zero_ns
    if start is None:
        stamped = [int(contents.times[id][1].min()) for id in contents.stamped_channels]
        start = min(stamped, default=first)
    facts, streams = source.file_info, source.streams
    return Summary(
        path=source.path,
        size=facts.size,
        library=facts.library,
        profile=facts.profile,
        complete=facts.complete,
        start_ns=start,
        duration=(last - first) / 1e9,
        streams=tuple(
            sorted(
                (
                    summarise_stream(streams[id].topic, streams[id].schema, t_ns, start, events)
                    for id, (_, t_ns) in contents.times.items()
                ),
                key=lambda stream: stream.topic,
            )
        ),
        events=events,
        losses=sum_losses(events),
        health=last_health_reports(events),
        bias_filters=_last_bias_filter_rows(source, contents.bias_filters, start),
        metadata=source.metadata,
        roles=roles,
        attachments=facts.attachments,
        damaged=facts.damaged,
        warnings=(*source.warnings(), *(f"{source.path}: {note}" for note in notes)),
    )


@dataclass
class _LogContents:
    """The parts of a log that its summary needs.

    Attributes
    ----------
    times : channel id -> (log times, measurement times), (n,) ns each.
    stamped_channels : ids of channels whose messages have a header stamp.
    event_payloads : JSON of the events.
    bias_filters : channel id -> decoder of a node's bias filter reports.
    non_finite_counts : (topic, field) -> number of sample messages that hold NaN or infinity in this field.
    joints : topic -> joint velocities.
    """

    times: dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]]
    stamped_channels: set[int]
    event_payloads: list[bytes]
    bias_filters: dict[int, ChannelDecoder]
    non_finite_counts: Counter[tuple[str, str]]
    joints: dict[str, JointSpeeds]


def _read_contents(log: MessageSource, progress: Progress | None) -> _LogContents:
    parts: dict[int, list[tuple[NDArray[np.int64], NDArray[np.int64]]]] = {}
    contents, budget = _LogContents({}, set(), [], {}, Counter(), {}), MemoryBudget(log.path)
    for messages in log.chunks():
        if progress:
            progress(f"reading {log.path.name}", log.progress)
        streams = log.streams
        budget.claim(_MESSAGE_TIMES_BYTES * len(messages.headers), "the array of its times")
        for id, chosen in messages.group_by_channel():
            if id not in streams:
                continue
            stream = streams[id]
            kind = normalise_type_name(stream.schema) if stream.encoding == "cdr" else ""
            headers = messages.headers[chosen]
            measured = headers["publish_time"].astype(np.int64)
            if kind in ros2.STAMPED_TYPES:
                # The stamp is the time of measurement; the recording time depends on the network load.
                measured = header_stamps(messages, chosen, measured)
                contents.stamped_channels.add(id)
            parts.setdefault(id, []).append((headers["log_time"].astype(np.int64), measured))
            if stream.topic == topics.EVENTS:
                budget.claim(
                    EVENT_MEMORY_RATIO * messages.total_record_size(chosen), "the list of its events"
                )
                contents.event_payloads += [
                    decode_string_message(stream.encoding, messages.payload(i)) for i in chosen.tolist()
                ]
            elif _is_bias_filter(stream):
                contents.bias_filters.setdefault(id, ChannelDecoder(ros2.FLOAT64_ARRAY, budget=budget)).feed(
                    messages, chosen
                )
            elif kind == ros2.JOINT_STATE:
                speeds = contents.joints.setdefault(stream.topic, JointSpeeds(budget))
                speeds.feed(messages, chosen[: max(0, _MAX_JOINT_MESSAGES - speeds.count)])
            elif kind in _MEASURED_FIELDS:
                for field, count in _count_non_finite(kind, messages, chosen).items():
                    contents.non_finite_counts[stream.topic, field] += count
    contents.times = {
        id: (np.concatenate([p[0] for p in times]), np.concatenate([p[1] for p in times]))
        for id, times in parts.items()
    }
    contents.non_finite_counts = +contents.non_finite_counts
    return contents


def _suggest_roles(
    source: MessageSource, contents: _LogContents, selection: TopicSelection
) -> tuple[Mapping[str, str], tuple[str, ...]]:
    """Return the roles of the topics of another program's log, and notes on ambiguous ones."""
    streams = source.streams
    candidates = {
        streams[id].topic: TopicCandidate(
            normalise_type_name(streams[id].schema),
            tuple(contents.joints[streams[id].topic].rows) if streams[id].topic in contents.joints else (),
        )
        for id in contents.times
        if streams[id].encoding == "cdr"
    }
    if is_hubodo_log(source) and not selection:
        return {}, ()
    selection = replace(selection, required_roles=frozenset())
    roles = assign_roles(candidates, selection, is_hubodo=is_hubodo_log(source), log_name=str(source.path))
    return {**roles.nodes, **roles.files}, roles.notes


_MESSAGE_TIMES_BYTES = 64
"""Memory per message: two times of 8 bytes, their sorted copies and sort indices."""
_MAX_JOINT_MESSAGES = 100
"""Number of messages that are decoded to learn the names of the joints."""
_MEASURED_FIELDS: Mapping[str, tuple[str, ...]] = {
    ros2.IMU: ("angular_velocity", "linear_acceleration"),
    ros2.NAV_SAT_FIX: ("latitude", "longitude", "altitude"),
    ros2.FLOAT64_ARRAY: ("data",),
}
"""Fields that must be finite in messages of samples."""


def _describe_non_finite(topic: str, field: str, count: int, message_count: int) -> str:
    if count == message_count:
        return f"{topic}: NaN or infinity in {field} of every message; NaN marks what was not measured"
    return f"{topic}: NaN or infinity in {field} of {count} messages"


def _count_non_finite(kind: str, messages: ChunkMessages, chosen: NDArray[np.intp]) -> dict[str, int]:
    """Count messages with NaN or infinity by field; fixes with status "no fix" do not count."""
    decoder = ChannelDecoder(kind)
    decoder.feed(messages, chosen)
    values = decoder.rows().values
    counts = {}
    for name in _MEASURED_FIELDS[kind]:
        if name not in values or not len(values[name]):
            continue
        finite = np.isfinite(values[name]).reshape(len(values[name]), -1).all(axis=1)
        if kind == ros2.NAV_SAT_FIX:
            finite |= values["status.status"] < 0
        counts[name] = int(np.count_nonzero(~finite))
    return counts


def _is_bias_filter(stream: Stream) -> bool:
    return normalise_type_name(stream.schema) == ros2.FLOAT64_ARRAY and stream.topic.endswith("/bias_filter")


def _last_bias_filter_rows(
    log: MessageSource, filters: Mapping[int, ChannelDecoder], start: int
) -> dict[str, Mapping[str, float]]:
    row_by_node: dict[str, Mapping[str, float]] = {}
    for id, decoder in filters.items():
        rows, stream = decoder.rows(), log.streams[id]
        names = parse_column_names(stream.metadata.get("columns", rows.label))
        if not len(rows) or names != list(BIAS_FILTER_COLUMNS[1:]):
            continue
        newest = int(np.argmax(rows.publish_ns))
        row = [(int(rows.publish_ns[newest]) - start) / 1e9, *rows.values["data"][newest].tolist()]
        if len(row) == len(BIAS_FILTER_COLUMNS) and np.isfinite(row[:4]).all():
            row_by_node[stream.topic[1:].removesuffix("/bias_filter")] = dict(
                zip(BIAS_FILTER_COLUMNS, row, strict=True)
            )
    return row_by_node
