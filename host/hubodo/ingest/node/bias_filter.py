"""What a node's own bias filter says: from the wire, into the log, and in words and numbers for people."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from hubodo.ingest.node.identity import known_name
from hubodo.ingest.node.samples import FilterSeen, Vector
from hubodo.recording import BIAS_FILTER_COLUMNS
from hubowire.messages import Filter, FilterState


def filter_seen(message: Filter, device_ns: int, step: float, t_ns: int) -> FilterSeen:
    """The node's numbers in rad/s; step: of its gyro, rad/s."""

    def vector(values: Iterable[float], factor: float) -> Vector:
        x, y, z = (value * factor for value in values)
        return x, y, z

    return FilterSeen(
        device_ns,
        message.state,
        message.samples,
        vector(message.rate_q8, step / 256.0),
        vector(message.bias_q12, step / 4096.0),
        vector((math.sqrt(variance / 256.0) for variance in message.variance_q8), step),
        vector((sigma or math.nan for sigma in message.bias_sigma_q12), step / 4096.0),
        message.saturations,
        t_ns,
    )


def filter_columns(seen: FilterSeen) -> dict[str, float]:
    """One row of the channel, by column."""
    values = (
        seen.state,
        seen.samples,
        seen.saturations,
        *seen.rate,
        *seen.bias,
        *seen.noise,
        *seen.bias_sigma,
    )
    return dict(zip(BIAS_FILTER_COLUMNS[1:], map(float, values), strict=True))


def seen_row(seen: FilterSeen) -> dict[str, float]:
    """The same with its device time, s, as `filter_words` takes it."""
    return {"t": seen.device_ns * 1e-9, **filter_columns(seen)}


def filter_json(seen: FilterSeen | None) -> dict[str, Any] | None:
    """For programs: rad/s; sigmas None where the node does not know them."""
    if seen is None:
        return None
    return {
        "state": known_name(FilterState, seen.state),
        "samples": seen.samples,
        "bias": list(seen.bias),
        "sigma": [None if math.isnan(sigma) else sigma for sigma in seen.bias_sigma],
    }


def filter_words(row: Mapping[str, float]) -> str:
    """A row of the channel in one line: the bias with its sigma, and what it rests on."""
    if row["state"] != FilterState.TRACKING:
        return f"{known_name(FilterState, int(row['state']))}, no bias is known"
    bias = ", ".join(f"{axis} {_value_words(row, axis)}" for axis in "xyz")
    samples = int(row["samples"])
    origin = f"from {samples} samples" if samples else "from the node's settings"
    return f"{bias} °/s, {origin}"


def _value_words(row: Mapping[str, float], axis: str) -> str:
    bias, sigma = math.degrees(row[f"bias_{axis}"]), math.degrees(row[f"sigma_{axis}"])
    return f"{bias:+.3f}" if math.isnan(sigma) else f"{bias:+.3f} ± {sigma:.3f}"
