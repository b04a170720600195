"""A node's own counters: what has become worse from one report to the next, in words and numbers."""

from __future__ import annotations

import math
from collections import deque
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


def supply(health: Health) -> tuple[float, float]:
    """Volts, and the charge that is left, 0 to 1; NaN where a node does not know it."""
    known = health.battery_percent <= 100
    return health.battery_mv / 1000, health.battery_percent / 100 if known else math.nan


def health_data(name: str, health: Health) -> dict[str, Any]:
    """The numbers of a report under their names on the wire."""
    return {"node": name, **{item.name: getattr(health, item.name) for item in fields(health)}}


class Supplies:
    """The newest voltages of a node."""

    def __init__(self) -> None:
        self._told: deque[tuple[int, float]] = deque(maxlen=8)

    def tell(self, t_ns: int, volts: float) -> None:
        """V, measured at t_ns."""
        self._told.append((t_ns, volts))

    def at(self, t_ns: int) -> float | None:
        """What was measured last, up to t_ns; None where nothing was."""
        return next((volts for then_ns, volts in reversed(self._told) if then_ns <= t_ns), None)
