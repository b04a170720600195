"""Extract the quantities of a verb's result that are compared between logs, nodes and days."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from hubodo.effects import BY_NAME

Result = Mapping[str, Any]

MISSING_EFFECT_PREFIX = "found."
"""Prefix of the quantity that reports an effect found by `gap`; its value is the confidence."""


@dataclass(frozen=True)
class LogQuantity:
    """One number of a log. node: "" for the whole log. sigma: None if unknown.

    p_value: p value of an effect found by `gap`; None for other quantities.
    """

    node: str
    quantity: str
    value: float
    sigma: float | None = None
    unit: str = ""
    p_value: float | None = None


def extract_quantities(verb: str, result: Result) -> list[LogQuantity]:
    """Return the numeric quantities of a result. verb: as in `hubodo batch`, such as `calibrate wheels`."""
    extracted = _EXTRACTORS[verb](result)
    return [item for item in extracted if isinstance(item.value, float | int)]


def _info(result: Result) -> Iterator[LogQuantity]:
    yield LogQuantity("", "duration", result["duration"], unit="s")
    yield LogQuantity("", "messages", result["messages"])
    yield LogQuantity("", "gaps", len(result["gaps"]))
    yield LogQuantity("", "damaged", result["damaged"])
    for stream in result["streams"]:
        node, _, kind = stream["topic"].strip("/").rpartition("/")
        if kind != "imu":
            continue
        total = stream["messages"] + stream["missing"]
        yield LogQuantity(node, "rate", stream["rate"], unit="Hz")
        yield LogQuantity(node, "jitter", stream["jitter"], unit="s")
        yield LogQuantity(node, "gaps", stream["gaps"])
        yield LogQuantity(node, "longest_gap", stream["longest"], unit="s")
        yield LogQuantity(node, "missing_share", stream["missing"] / max(1, total))
    for node, row in result["bias_filter"].items():
        for axis in "xyz":
            yield LogQuantity(
                node, f"bias.{axis}", row.get(f"bias_{axis}"), row.get(f"sigma_{axis}"), "rad/s"
            )


def _fuse(result: Result) -> Iterator[LogQuantity]:
    yield LogQuantity("", "distance", result["distance"], unit="m")
    for name, value in result.get("truth", {}).items():
        unit = "%" if name.endswith("percent") else "rad" if name in ("heading_rms", "rotation") else "m"
        yield LogQuantity("", f"truth.{name}", value, unit=unit)
    yield from _effects("", result.get("vehicle", {}))
    for node, effects in result.get("nodes", {}).items():
        yield from _effects(node, effects)


def _allan(result: Result) -> Iterator[LogQuantity]:
    for one in result.get("sensors", [result]):
        node, channel = one["node"], one["channel"]
        for name, term in one["coefficients"].items():
            yield LogQuantity(node, f"{channel}.{name}", term["value"], term["sigma"], term["unit"])
        best = one["optimum_averaging_time"], one["smallest_deviation"]
        yield LogQuantity(node, f"{channel}.best_averaging_time", best[0], unit="s")
        yield LogQuantity(node, f"{channel}.smallest_deviation", best[1], unit=one["unit"])


def _warmup(result: Result) -> Iterator[LogQuantity]:
    node, channel = result["node"], result["channel"]
    for name in ("c1", "c2", "time_constant"):
        term = result[name]
        yield LogQuantity(node, f"{channel}.{name}", term["value"], term["sigma"], term["unit"])
    yield LogQuantity(node, f"{channel}.white", float(result["white"]))


def _calibrate_wheels(result: Result) -> Iterator[LogQuantity]:
    yield from _effects("", result["vehicle"])
    for node, effects in result["nodes"].items():
        yield from _effects(node, effects)


def _calibrate_imu(result: Result) -> Iterator[LogQuantity]:
    yield from _effects(result["node"], result["effects"])
    for name, value in result["accel_norm"].items():
        yield LogQuantity(result["node"], f"accel_norm.{name}", value, unit="m/s²")


def _gap(result: Result) -> Iterator[LogQuantity]:
    yield LogQuantity("", "gap.before", result["gap"]["before"])
    yield LogQuantity("", "gap.after", result["gap"]["after"])
    for finding in result["found"]:
        node, effect = finding["scope"], finding["effect"]
        p_value = finding["p_value"]
        yield LogQuantity(node, MISSING_EFFECT_PREFIX + effect, finding["confidence"], p_value=p_value)
        for name, it in finding["parameters"].items():
            yield LogQuantity(node, f"{effect}.{name}", it["value"], it["sigma"], it["unit"])


def _report(result: Result) -> Iterator[LogQuantity]:
    yield LogQuantity("", "page", result["size"], unit="byte")
    yield LogQuantity("", "not_shown", len(result["missing"]))


def _export(result: Result) -> Iterator[LogQuantity]:
    for name, rows in result["rows"].items():
        yield LogQuantity(name, "rows", rows)


def _effects(node: str, effects: Mapping[str, Any]) -> Iterator[LogQuantity]:
    for effect, parameters in effects.items():
        for name, it in parameters.items():
            known = BY_NAME.get(effect)
            unit = it.get("unit") or ("" if known is None else known.unit(name))
            yield LogQuantity(node, f"{effect}.{name}", it["value"], it["sigma"], unit)


_EXTRACTORS: Mapping[str, Callable[[Result], Iterator[LogQuantity]]] = {
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
