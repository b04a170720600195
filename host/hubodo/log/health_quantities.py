"""Names and units of the quantities in a node's health report, for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

_QUANTITIES: Mapping[str, tuple[str, float, str]] = {
    "t_us": ("time of its clock", 1e-6, "s"),
    "battery_mv": ("battery", 1e-3, "V"),
    "battery_percent": ("battery charge", 1.0, "%"),
    "samples_missed": ("samples missed", 1.0, ""),
    "frames_dropped": ("frames dropped", 1.0, ""),
    "frames_damaged": ("frames damaged", 1.0, ""),
    "fifo_overruns": ("FIFO overruns", 1.0, ""),
    "i2c_errors": ("I²C errors", 1.0, ""),
    "bus_recoveries": ("bus recoveries", 1.0, ""),
    "queue_high_water": ("longest queue", 1.0, "frames"),
    "worst_loop_us": ("slowest loop", 1e-3, "ms"),
    "stamp_bound_us": ("bound of time stamps", 1e-3, "ms"),
    "free_heap": ("free memory", 1e-3, "kB"),
}
COUNTERS = (
    "samples_missed",
    "frames_dropped",
    "frames_damaged",
    "fifo_overruns",
    "i2c_errors",
    "bus_recoveries",
)
"""Quantities that are zero on a healthy node."""


def describe_health(values: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield key, name and value with unit of each quantity of a report, in a fixed order."""
    for key, (name, factor, unit) in _QUANTITIES.items():
        if isinstance(value := values.get(key), int | float):
            shown = f"{factor * value:.4g}" if factor != 1.0 else str(value)
            yield key, name, f"{shown} {unit}".rstrip()
    for key, value in values.items():
        if key not in _QUANTITIES and key != "node":
            shown = f"{value:#x}" if key == "faults" and isinstance(value, int) and value else str(value)
            yield key, key.replace("_", " "), shown
