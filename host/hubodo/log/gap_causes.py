"""Causes of gaps, total losses and last health reports, from the events of a log."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from hubodo.log import topics
from hubodo.recording import Event


@dataclass(frozen=True)
class LossTotal:
    """The sum of recorded `gap` events of one node, stream and cause; unknown: events without a count."""

    node: str
    stream: str
    cause: str
    gaps: int
    samples: int
    frames: int
    unknown: int
    duration: float


_WIRE_MESSAGE_OF_TOPIC: Mapping[str, str] = {
    "imu": "ImuBatch",
    "mag": "Mag",
    "bias_filter": "Filter",
    "high_g": "HighG",
}
"""Topic suffix of a node -> name of its wire message in `gap` events."""


def explain_gap(topic: str, begin_ns: int, end_ns: int, events: Iterable[Event]) -> str:
    """Return the cause given by the `gap` event of the same node that overlaps most in time."""
    high_g_node = topic.removeprefix(topics.COLUMNS_PREFIX + topics.HIGH_G_PREFIX)
    node, _, kind = topic[1:].partition("/") if high_g_node == topic else (high_g_node, "", "high_g")
    wire_message = _WIRE_MESSAGE_OF_TOPIC.get(kind, kind)
    longest_overlap, explanation = 0, ""
    for event in events:
        concerned = event.data.get("node", event.source)
        if event.kind != "gap" or concerned not in (node, "", None):
            continue
        if event.data.get("stream", wire_message) != wire_message:
            continue
        duration = event.data.get("duration_s")
        end_of_event_ns = (
            event.t_ns + int(1e9 * duration) if isinstance(duration, int | float) else event.t_ns
        )
        overlap = min(end_ns, end_of_event_ns) - max(begin_ns, event.t_ns) + 1
        if overlap > longest_overlap:
            longest_overlap, explanation = overlap, str(event.data.get("cause") or event.text)
    return explanation or "not explained by any event"


def last_health_reports(events: Iterable[Event]) -> dict[str, Mapping[str, Any]]:
    """Return the last health report of each node."""
    return {
        str(event.data.get("node", event.source)): event.data for event in events if event.kind == "health"
    }


def sum_losses(events: Iterable[Event]) -> tuple[LossTotal, ...]:
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
            gaps=len(events_of_group),
            samples=sum(data.get("samples_lost") or 0 for data in events_of_group),
            frames=sum(data.get("frames_lost") or 0 for data in events_of_group),
            unknown=sum(data.get("samples_lost", 0) is None for data in events_of_group),
            duration=sum(data.get("duration_s") or 0.0 for data in events_of_group),
        )
        for key, events_of_group in sorted(groups.items())
    )
