"""What a log holds and how good it is: streams, measured rates, gaps and what explains them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.log import ros2, topics
from hubodo.log.chunk_reader import Messages
from hubodo.log.decode import Decoder, column_names, message_type, stamps
from hubodo.log.hubodo_messages import decode_string_message, parse_events
from hubodo.log.input_limits import MemoryBudget
from hubodo.log.joints import JointSpeeds
from hubodo.log.logfile import open_log
from hubodo.log.recording_reader import EVENT_MEMORY_RATIO
from hubodo.log.roles import SELECT_BY_TYPE, TopicCandidate, TopicSelection, assign_roles
from hubodo.log.source import MessageSource, Stream, is_hubodo_log
from hubodo.recording import BIAS_FILTER_COLUMNS, Event

Progress = Callable[[str, float], None]

GAP_FACTOR = 1.5
"""An interval longer than this many median periods is a gap: at least one sample is missing."""
_ODOMETRY_FACTOR = 2.5
"""The same for odometry: a pose for each sample of two nodes, whose rates beat, comes at uneven times."""


@dataclass(frozen=True)
class SampleGap:
    """An interval without samples. t: s since t = 0; missing: samples that fit into it; cause: in words."""

    topic: str
    t: float
    duration: float
    missing: int
    cause: str


@dataclass(frozen=True)
class LossTotal:
    """The recorded `gap` events of one node, stream and cause, added up; unknown: those without a count."""

    node: str
    stream: str
    cause: str
    gaps: int
    samples: int
    frames: int
    unknown: int
    duration: float


@dataclass(frozen=True)
class StreamSummary:
    """One topic; times in s, by header stamp where there is one, else by publish time.

    period: median; jitter: 1 sigma about it, gaps left out.
    """

    topic: str
    schema: str
    messages: int
    first: float
    last: float
    period: float | None
    jitter: float | None
    longest: float | None
    gaps: tuple[SampleGap, ...]

    @property
    def rate(self) -> float | None:
        """1 / median period, Hz."""
        return 1 / self.period if self.period else None

    @property
    def missing(self) -> int:
        """Samples that fit into the gaps."""
        return sum(gap.missing for gap in self.gaps)


@dataclass(frozen=True)
class Summary:
    """All of `hubodo info`. start_ns: host time of t = 0; duration: s between first and last message.

    bias_filters: the last row of what each node's own filter said, columns `BIAS_FILTER_COLUMNS`. roles: what
    the topics of another program's log are taken for, node or file to topic.
    attachments: bytes of each file kept in the log. damaged: places of it that could not be used, and
    checksums that fail.
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
        """The gaps of all streams in order of time."""
        return tuple(sorted((gap for s in self.streams for gap in s.gaps), key=lambda gap: gap.t))

    def seconds(self, t_ns: int) -> float:
        """Host time as seconds since t = 0."""
        return (t_ns - self.start_ns) / 1e9


def summarise(path: Path, *, progress: Progress | None = None) -> Summary:
    """Read an MCAP file once and describe it. Raises LogError when it is missing, empty or no MCAP."""
    with open_log(path) as log:
        return summarise_source(log, progress=progress)


def summarise_source(
    source: MessageSource, choice: TopicSelection = SELECT_BY_TYPE, *, progress: Progress | None = None
) -> Summary:
    """Read a log once and describe it. choice: what the user says of its topics.

    Raises InputError for a --topic that is not there, or of another type.
    """
    found = _collect(source, progress)
    events, notes = parse_events(found.payloads)
    roles, doubts = _roles(source, found, choice)
    notes = (
        *notes,
        *doubts,
        *(f"{topic}: {count} messages hold NaN or infinity" for topic, count in found.unsound.items()),
    )
    first = min((int(log_ns.min()) for log_ns, _ in found.times.values()), default=0)
    last = max((int(log_ns.max()) for log_ns, _ in found.times.values()), default=0)
    start = source.t_zero_ns
    if start is None:
        stamped = [int(found.times[id][1].min()) for id in found.stamped]
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
                    _stream(streams[id].topic, streams[id].schema, t_ns, start, events)
                    for id, (_, t_ns) in found.times.items()
                ),
                key=lambda stream: stream.topic,
            )
        ),
        events=events,
        losses=_losses(events),
        health=_health(events),
        bias_filters=_bias_filters(source, found.filters, start),
        metadata=source.metadata,
        roles=roles,
        attachments=facts.attachments,
        damaged=facts.damaged,
        warnings=(*source.warnings(), *(f"{source.path}: {note}" for note in notes)),
    )


@dataclass
class _Found:
    """By channel, log times and those of measuring; which have stamps; payloads of events; nodes' filters.

    unsound: by topic, how many messages of samples hold what is not finite.
    """

    times: dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]]
    stamped: set[int]
    payloads: list[bytes]
    filters: dict[int, Decoder]
    unsound: Counter[str]
    joints: dict[str, JointSpeeds]


def _collect(log: MessageSource, progress: Progress | None) -> _Found:
    parts: dict[int, list[tuple[NDArray[np.int64], NDArray[np.int64]]]] = {}
    found, budget = _Found({}, set(), [], {}, Counter(), {}), MemoryBudget(log.path)
    for messages in log.chunks():
        if progress:
            progress(f"reading {log.path.name}", log.progress)
        streams = log.streams
        budget.claim(_TIME_BYTES * len(messages.heads), "the array of its times")
        for id, chosen in messages.by_channel():
            if id not in streams:
                continue
            stream = streams[id]
            kind = message_type(stream.schema) if stream.encoding == "cdr" else ""
            heads = messages.heads[chosen]
            measured = heads["publish_time"].astype(np.int64)
            if kind in ros2.STAMPED:
                # What is read is when a sample was taken; a recorder's times tell how busy the network was.
                measured = stamps(messages, chosen, measured)
                found.stamped.add(id)
            parts.setdefault(id, []).append((heads["log_time"].astype(np.int64), measured))
            if stream.topic == topics.EVENTS:
                budget.claim(EVENT_MEMORY_RATIO * messages.size_of(chosen), "the list of its events")
                found.payloads += [
                    decode_string_message(stream.encoding, messages.payload(i)) for i in chosen.tolist()
                ]
            elif _of_filter(stream):
                found.filters.setdefault(id, Decoder(ros2.COLUMNS, budget=budget)).feed(messages, chosen)
            elif kind == ros2.JOINT_STATE:
                speeds = found.joints.setdefault(stream.topic, JointSpeeds(budget))
                speeds.feed(messages, chosen[: max(0, _JOINTS - speeds.count)])
            elif kind in _MEASURED:
                found.unsound[stream.topic] += _unsound(kind, messages, chosen)
    found.times = {
        id: (np.concatenate([p[0] for p in of_one]), np.concatenate([p[1] for p in of_one]))
        for id, of_one in parts.items()
    }
    found.unsound = +found.unsound
    return found


def _roles(
    source: MessageSource, found: _Found, choice: TopicSelection
) -> tuple[Mapping[str, str], tuple[str, ...]]:
    """What the topics of a foreign log would be taken for, and what is in doubt."""
    streams = source.streams
    candidates = {
        streams[id].topic: TopicCandidate(
            message_type(streams[id].schema),
            tuple(found.joints[streams[id].topic].rows) if streams[id].topic in found.joints else (),
        )
        for id in found.times
        if streams[id].encoding == "cdr"
    }
    if is_hubodo_log(source) and not choice:
        return {}, ()
    choice = replace(choice, required_roles=frozenset())
    roles = assign_roles(candidates, choice, is_hubodo=is_hubodo_log(source), log_name=str(source.path))
    return {**roles.nodes, **roles.files}, roles.notes


_TIME_BYTES = 64
"""Bytes of memory per message: two times of 8 bytes, their copies in order, and what sorts them."""
_JOINTS = 100
"""So many messages tell the names of the joints."""
_MEASURED: Mapping[str, tuple[str, ...]] = {
    ros2.IMU: ("angular_velocity", "linear_acceleration"),
    ros2.NAV_SAT_FIX: ("latitude", "longitude", "altitude"),
    ros2.COLUMNS: ("data",),
}
"""What a message measured, of those whose numbers all count."""


def _unsound(kind: str, messages: Messages, chosen: NDArray[np.intp]) -> int:
    """How many of these messages hold NaN or infinity; fixes that say that they are none are not counted."""
    decoder = Decoder(kind)
    decoder.feed(messages, chosen)
    values = decoder.rows().values
    parts = [values[name] for name in _MEASURED[kind] if name in values]
    if not parts or not len(parts[0]):
        return 0
    good = np.isfinite(np.column_stack(parts)).all(axis=1)
    if kind == ros2.NAV_SAT_FIX:
        good |= values["status.status"] < 0
    return int(np.count_nonzero(~good))


def _of_filter(stream: Stream) -> bool:
    return message_type(stream.schema) == ros2.COLUMNS and stream.topic.endswith("/bias_filter")


def _bias_filters(
    log: MessageSource, filters: Mapping[int, Decoder], start: int
) -> dict[str, Mapping[str, float]]:
    found: dict[str, Mapping[str, float]] = {}
    for id, decoder in filters.items():
        rows, stream = decoder.rows(), log.streams[id]
        names = column_names(stream.metadata.get("columns", rows.label))
        if not len(rows) or names != list(BIAS_FILTER_COLUMNS[1:]):
            continue
        newest = int(np.argmax(rows.publish_ns))
        row = [(int(rows.publish_ns[newest]) - start) / 1e9, *rows.values["data"][newest].tolist()]
        if len(row) == len(BIAS_FILTER_COLUMNS) and np.isfinite(row[:4]).all():
            found[stream.topic[1:].removesuffix("/bias_filter")] = dict(
                zip(BIAS_FILTER_COLUMNS, row, strict=True)
            )
    return found


_BESIDE = {ros2.TEMPERATURE, ros2.BATTERY}
"""Of which a node tells now and then: with a usual period, without gaps."""
_SAMPLED = (ros2.STAMPED - _BESIDE) | {ros2.COLUMNS}


def _stream(
    topic: str, schema: str, publish_ns: NDArray[np.int64], start: int, events: Iterable[Event]
) -> StreamSummary:
    t_ns = np.sort(publish_ns)
    periods = np.diff(t_ns) / 1e9
    # Events and raw frames come when they come; a period is a property of sampled streams.
    factor = _ODOMETRY_FACTOR if message_type(schema) == ros2.ODOMETRY else GAP_FACTOR
    sampled = message_type(schema) in _SAMPLED | _BESIDE
    usual = float(np.median(periods)) if len(periods) and sampled else None
    regular = periods[periods <= factor * usual] if usual is not None else periods
    gaps: tuple[SampleGap, ...] = ()
    if usual and message_type(schema) in _SAMPLED:
        found = np.flatnonzero(periods > factor * usual)
        gaps = tuple(
            SampleGap(
                topic,
                (int(t_ns[i]) - start) / 1e9,
                float(periods[i]),
                max(1, round(float(periods[i]) / usual) - 1),
                _cause(topic, int(t_ns[i]), int(t_ns[i + 1]), events),
            )
            for i in found.tolist()
        )
    return StreamSummary(
        topic=topic,
        schema=schema,
        messages=len(t_ns),
        first=(int(t_ns[0]) - start) / 1e9,
        last=(int(t_ns[-1]) - start) / 1e9,
        period=usual,
        jitter=float(np.sqrt(np.mean((regular - usual) ** 2))) if usual is not None else None,
        longest=float(periods.max()) if usual is not None else None,
        gaps=gaps,
    )


_WIRE_STREAMS: Mapping[str, str] = {"imu": "ImuBatch", "mag": "Mag", "bias_filter": "Filter"}
"""The wire message behind a node's topic, as `gap` events name it."""


def _cause(topic: str, begin_ns: int, end_ns: int, events: Iterable[Event]) -> str:
    """The words of that recorded gap of the same node which overlaps most in time."""
    node, _, kind = topic[1:].partition("/")
    part = _WIRE_STREAMS.get(kind, kind)
    best, words = 0, ""
    for event in events:
        concerned = event.data.get("node", event.source)
        if event.kind != "gap" or concerned not in (node, "", None):
            continue
        if event.data.get("stream", part) != part:
            continue
        duration = event.data.get("duration_s")
        until = event.t_ns + int(1e9 * duration) if isinstance(duration, int | float) else event.t_ns
        overlap = min(end_ns, until) - max(begin_ns, event.t_ns) + 1
        if overlap > best:
            best, words = overlap, str(event.data.get("cause") or event.text)
    return words or "not explained by any event"


def _health(events: Iterable[Event]) -> dict[str, Mapping[str, Any]]:
    """The last health report of each node."""
    return {
        str(event.data.get("node", event.source)): event.data for event in events if event.kind == "health"
    }


def _losses(events: Iterable[Event]) -> tuple[LossTotal, ...]:
    groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
    for event in events:
        if event.kind == "gap":
            key = (
                str(event.data.get("node", event.source)),
                str(event.data.get("stream", "")),
                str(event.data.get("cause") or event.text),
            )
            groups.setdefault(key, []).append(event.data)
    return tuple(
        LossTotal(
            *key,
            gaps=len(found),
            samples=sum(data.get("samples_lost") or 0 for data in found),
            frames=sum(data.get("frames_lost") or 0 for data in found),
            unknown=sum(data.get("samples_lost", 0) is None for data in found),
            duration=sum(data.get("duration_s") or 0.0 for data in found),
        )
        for key, found in sorted(groups.items())
    )
