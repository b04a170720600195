"""Health reports of a node: counters that have grown, supply voltage, and JSON."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from hubodo.recording import Event
from hubowire.messages import Fault, Health

_REPORTED_COUNTERS = (
    "i2c_errors",
    "bus_recoveries",
    "fifo_overruns",
    "samples_missed",
    "frames_dropped",
    "frames_damaged",
)


def report_worsening(name: str, before: Health | None, now: Health, t_ns: int) -> Iterator[Event]:
    """Yield an event if counters or faults of a node have grown since its previous report."""
    grown = {
        key: getattr(now, key) - (getattr(before, key) if before else 0)
        for key in _REPORTED_COUNTERS
        if getattr(now, key) > (getattr(before, key) if before else 0)
    }
    new_faults = now.faults & ~(before.faults if before else 0)
    fault_names = [fault.name.lower().replace("_", " ") for fault in Fault if fault & new_faults]
    if not grown and not fault_names:
        return
    parts = fault_names + [f"{key.replace('_', ' ')} +{value}" for key, value in grown.items()]
    yield Event(t_ns, "health", name, f"{name}: {', '.join(parts)}", health_json(name, now))


def is_asleep(health: Health | None) -> bool:
    """Return True if a node is parked and waits for motion, by its newest report."""
    return health is not None and bool(health.faults & Fault.ASLEEP)


def read_supply(health: Health) -> tuple[float, float]:
    """Return the supply voltage, V, and the remaining charge, 0 to 1; NaN where the node does not know it."""
    known = health.battery_percent <= 100
    return health.battery_mv / 1000, health.battery_percent / 100 if known else math.nan


def health_json(name: str, health: Health) -> dict[str, Any]:
    """Return the fields of a health report under their names on the wire."""
    return {"node": name, **{item.name: getattr(health, item.name) for item in fields(health)}}


class SupplyHistory:
    """The newest supply voltages of a node."""

    def __init__(self) -> None:
        self._voltages: deque[tuple[int, float]] = deque(maxlen=8)

    def add(self, t_ns: int, volts: float) -> None:
        """Add a voltage, V, measured at `t_ns`."""
        self._voltages.append((t_ns, volts))

    def voltage_at(self, t_ns: int) -> float | None:
        """Return the newest voltage up to `t_ns`, V; None before the first."""
        return next((volts for then_ns, volts in reversed(self._voltages) if then_ns <= t_ns), None)
