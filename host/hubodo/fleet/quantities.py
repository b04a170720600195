"""A verb's result as quantities: what of it is compared between logs, nodes and days."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

Result = Mapping[str, Any]

FOUND = "found."
"""Begins the name of a quantity that says that an effect was found: value its confidence."""


@dataclass(frozen=True)
class Measured:
    """One number of a log. node: whose, "" for the whole log. sigma: None where nobody knows it.

    p_value: of an effect that was found, None of everything else.
    """

    node: str
    quantity: str
    value: float
    sigma: float | None = None
    unit: str = ""
    p_value: float | None = None


def quantities(verb: str, result: Result) -> list[Measured]:
    """What is compared; verb: as in `hubodo batch`, `calibrate wheels` among them. Numbers alone are kept."""
    made = _OF_VERB[verb](result)
    return [item for item in made if isinstance(item.value, float | int)]


def _info(result: Result) -> Iterator[Measured]:
    yield Measured("", "duration", result["duration"], unit="s")
    yield Measured("", "messages", result["messages"])
    yield Measured("", "gaps", len(result["gaps"]))
    yield Measured("", "damaged", result["damaged"])
    for stream in result["streams"]:
        node, _, kind = stream["topic"].strip("/").rpartition("/")
        if kind != "imu":
            continue
        total = stream["messages"] + stream["missing"]
        yield Measured(node, "rate", stream["rate"], unit="Hz")
        yield Measured(node, "jitter", stream["jitter"], unit="s")
        yield Measured(node, "gaps", stream["gaps"])
        yield Measured(node, "longest_gap", stream["longest"], unit="s")
        yield Measured(node, "missing_share", stream["missing"] / max(1, total))
    for node, row in result["bias_filter"].items():
        for axis in "xyz":
            yield Measured(node, f"bias.{axis}", row.get(f"bias_{axis}"), row.get(f"sigma_{axis}"), "rad/s")


def _fuse(result: Result) -> Iterator[Measured]:
    yield Measured("", "distance", result["distance"], unit="m")
    for name, value in result.get("truth", {}).items():
        yield Measured("", f"truth.{name}", value, unit="%" if name.endswith("percent") else "")
    yield from _effects("", result.get("vehicle", {}))
    for node, effects in result.get("nodes", {}).items():
        yield from _effects(node, effects)


def _allan(result: Result) -> Iterator[Measured]:
    for one in result.get("sensors", [result]):
        node, channel = one["node"], one["channel"]
        for name, term in one["coefficients"].items():
            yield Measured(node, f"{channel}.{name}", term["value"], term["sigma"], term["unit"])
        best = one["optimum_averaging_time"], one["smallest_deviation"]
        yield Measured(node, f"{channel}.best_averaging_time", best[0], unit="s")
        yield Measured(node, f"{channel}.smallest_deviation", best[1], unit=one["unit"])


def _warmup(result: Result) -> Iterator[Measured]:
    node, channel = result["node"], result["channel"]
    for name in ("c1", "c2", "time_constant"):
        term = result[name]
        yield Measured(node, f"{channel}.{name}", term["value"], term["sigma"], term["unit"])
    yield Measured(node, f"{channel}.white", float(result["white"]))


def _calibrate_wheels(result: Result) -> Iterator[Measured]:
    yield from _effects("", result["vehicle"])
    for node, effects in result["nodes"].items():
        yield from _effects(node, effects)


def _calibrate_imu(result: Result) -> Iterator[Measured]:
    yield from _effects(result["node"], result["effects"])
    for name, value in result["accel_norm"].items():
        yield Measured(result["node"], f"accel_norm.{name}", value, unit="m/s²")


def _gap(result: Result) -> Iterator[Measured]:
    yield Measured("", "gap.before", result["gap"]["before"])
    yield Measured("", "gap.after", result["gap"]["after"])
    for finding in result["found"]:
        node, effect = finding["scope"], finding["effect"]
        p_value = finding["p_value"]
        yield Measured(node, FOUND + effect, finding["confidence"], p_value=p_value)
        for name, it in finding["parameters"].items():
            yield Measured(node, f"{effect}.{name}", it["value"], it["sigma"], it["unit"])


def _report(result: Result) -> Iterator[Measured]:
    yield Measured("", "page", result["size"], unit="byte")
    yield Measured("", "not_shown", len(result["missing"]))


def _export(result: Result) -> Iterator[Measured]:
    for name, rows in result["rows"].items():
        yield Measured(name, "rows", rows)


def _effects(node: str, effects: Mapping[str, Any]) -> Iterator[Measured]:
    for effect, parameters in effects.items():
        for name, it in parameters.items():
            yield Measured(node, f"{effect}.{name}", it["value"], it["sigma"], it.get("unit", ""))


_OF_VERB: Mapping[str, Callable[[Result], Iterator[Measured]]] = {
    "info": _info,
    "fuse": _fuse,
    "allan": _allan,
    "warmup": _warmup,
    "calibrate wheels": _calibrate_wheels,
    "calibrate imu": _calibrate_imu,
    "gap": _gap,
    "report": _report,
    "export": _export,
}
