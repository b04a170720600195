"""Lines of `hubodo info` about the nodes of a log, their health and its origin; each fact appears once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

_MAX_VALUE_LENGTH = 100
_SHOWN_ELSEWHERE = ("t_zero_ns", "hubodo", "fingerprint", "ports")
"""Keys whose content the heading, the streams or the lines of the nodes show."""
_HIDDEN_PREFIXES = ("hubodo.csv.", "node.")
_COUNTERS = {
    "i2c_errors": "I²C errors",
    "bus_recoveries": "bus recoveries",
    "fifo_overruns": "FIFO overruns",
    "samples_missed": "samples missed",
    "frames_dropped": "frames dropped",
    "frames_damaged": "frames damaged",
}


def node_lines(metadata: Mapping[str, str]) -> Iterator[str]:
    """Yield one line for each node that announced itself: chips, firmware, rate, ranges, serial."""
    nodes: dict[str, dict[str, str]] = {}
    for key, text in metadata.items():
        prefix, _, suffix = key.partition(".")
        name, _, entry = suffix.partition(".")
        if prefix == "node" and entry:
            nodes.setdefault(name, {})[entry] = text
    for name, entries in nodes.items():
        chips = [part.split()[-1] for part in entries.get("parts", "").split(";") if part.strip()]
        facts = [" and ".join(chips)] + [
            pattern.format(entries[key])
            for key, pattern in (
                ("firmware", "firmware {}"),
                ("rate_hz", "{} Hz"),
                ("gyro_range_dps", "gyro ±{} deg/s"),
                ("accel_range_g", "accelerometer ±{} g"),
                ("serial", "serial {}"),
                ("boot_id", "start {}"),
            )
            if key in entries
        ]
        yield f"node {name}: {', '.join(fact for fact in facts if fact)}"


def health_line(node: str, values: Mapping[str, Any]) -> str:
    """Return the last health report of a node in words; counters that are zero are not listed."""
    facts = []
    if "battery_mv" in values:
        facts.append(f"battery {int(values['battery_mv']) / 1000:.2f} V")
    counted = [
        f"{values[key]} {words}" for key, words in _COUNTERS.items() if int(values.get(key, 0) or 0) > 0
    ]
    facts += counted or ["no errors, overruns or losses"]
    if int(values.get("faults", 0) or 0):
        facts.append(f"faults {int(values['faults']):#x}")
    if "queue_high_water" in values:
        facts.append(f"longest queue {values['queue_high_water']} frames")
    shown = {"node", "t_us", "battery_mv", "faults", "queue_high_water", *_COUNTERS}
    facts += [f"{key} {value}" for key, value in values.items() if key not in shown]
    at = f" at {int(values['t_us']) / 1e6:.1f} s of its clock" if "t_us" in values else ""
    return f"health of {node}{at}: {', '.join(facts)}"


def metadata_lines(metadata: Mapping[str, str]) -> Iterator[str]:
    """Yield the remaining metadata, in one line each; long ones are shortened."""
    for key, text in metadata.items():
        if key in _SHOWN_ELSEWHERE or key.startswith(_HIDDEN_PREFIXES):
            continue
        line = " ".join(text.split())
        if len(line) > _MAX_VALUE_LENGTH or "\n" in text.strip():
            line = f"{line[: _MAX_VALUE_LENGTH // 2]}... ({len(text)} characters; --json shows all)"
        yield f"{key}: {line}"
