"""Repeatability of the bias over power cycles: records of one channel, pooled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.calibration.parameter_table import format_with_sigma
from hubodo.sensors.allan.ieee952 import rate_unit

if TYPE_CHECKING:
    from hubodo.sensors.allan.result import AllanResult


@dataclass(frozen=True)
class BiasRepeatability:
    """The biases of one channel in several records, rad/s or m/s².

    Attributes:
        channel, node: of the records.
        biases: mean of each record.
        deviation, sigma: standard deviation from record to record, and its 1σ.
    """

    channel: str
    node: str
    biases: tuple[float, ...]
    deviation: float
    sigma: float

    def as_json(self) -> dict[str, Any]:
        """Return the repeatability for the JSON result."""
        return {
            "node": self.node,
            "channel": self.channel,
            "biases": list(self.biases),
            "deviation": {"value": self.deviation, "sigma": self.sigma},
        }

    def describe(self) -> str:
        """Return the repeatability in one sentence."""
        unit = rate_unit(self.channel).shown()
        values = format_with_sigma(self.deviation * unit.factor, self.sigma * unit.factor).replace("+", "", 1)
        return (
            f"{self.node} {self.channel}: the bias repeats within {values} {unit.name} (1σ) over "
            f"{len(self.biases)} records"
        )


def find_bias_repeatability(results: Sequence[AllanResult]) -> tuple[BiasRepeatability, ...]:
    """Return the repeatability of each channel that several logs hold.

    The standard deviation s of n biases has the 1σ s / √(2 (n - 1)), as of Gaussian values.
    """
    groups: dict[tuple[str, str], list[AllanResult]] = {}
    for result in results:
        groups.setdefault((result.node, result.channel), []).append(result)
    pooled = []
    for (node, channel), members in groups.items():
        if len({it.log for it in members}) < 2:
            continue
        biases = tuple(float(np.mean(it.record.values[it.record.present])) for it in members)
        spread = float(np.std(biases, ddof=1))
        pooled.append(
            BiasRepeatability(channel, node, biases, spread, spread / math.sqrt(2.0 * (len(biases) - 1)))
        )
    return tuple(pooled)
