"""Lines of `hubodo info` about the nodes of a log, their health and its origin; each fact appears once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from hubodo.log.health_quantities import COUNTERS, describe_health

_MAX_VALUE_LENGTH = 100
_SHOWN_ELSEWHERE = ("t_zero_ns", "hubodo", "fingerprint", "ports")
"""Keys whose content the heading, the streams or the lines of the nodes show."""
_HIDDEN_PREFIXES = ("hubodo.csv.", "node.")


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
    facts, at = [], ""
    for key, name, value in describe_health(values):
        if key == "t_us":
            at = f" at {value} of its clock"
        elif not (key in (*COUNTERS, "faults") and values[key] == 0):
            facts.append(f"{name} {value}")
    if not any(values.get(key) for key in COUNTERS):
        facts.insert(0, "no errors, overruns or losses")
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
