"""A node's own counters: what has become worse from one report to the next, in words and numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from hubodo.recording import Event
from hubowire.messages import Fault, Health

_WATCHED = (
    "i2c_errors",
    "bus_recoveries",
    "fifo_overruns",
    "samples_missed",
    "frames_dropped",
    "frames_damaged",
)


def worsened(name: str, before: Health | None, now: Health, t_ns: int) -> Iterator[Event]:
    """What has become worse since the node's last report."""
    grown = {
        key: getattr(now, key) - (getattr(before, key) if before else 0)
        for key in _WATCHED
        if getattr(now, key) > (getattr(before, key) if before else 0)
    }
    new_faults = now.faults & ~(before.faults if before else 0)
    named = [fault.name.lower().replace("_", " ") for fault in Fault if fault & new_faults]
    if not grown and not named:
        return
    parts = named + [f"{key.replace('_', ' ')} +{value}" for key, value in grown.items()]
    yield Event(t_ns, "health", name, f"{name}: {', '.join(parts)}", health_data(name, now))


def health_data(name: str, health: Health) -> dict[str, Any]:
    """The numbers of a report under their names on the wire."""
    return {"node": name, **{item.name: getattr(health, item.name) for item in fields(health)}}
