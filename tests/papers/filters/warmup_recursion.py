"""The bias of a gyro that warms up, sample by sample: eq. (6) of Barshan and Durrant-Whyte, from any age."""

from __future__ import annotations

import math

from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.effects.warmup import WarmupModel


class BiasRecursion:
    """The bias sample by sample, as in a filter or a node: eq. (6) of the paper, started at any age.

    eps(k + 1) = T / (T + dt) eps(k) + dt / (T + dt) (C1 + C2), for each exponential; the temperature term is
    added separately. age: time since power-on at the first sample, s.
    """

    def __init__(self, model: WarmupModel, dt: float, age: float = 0.0) -> None:
        self._coefficient = model.temperature_coefficient
        self._base = model.c2
        pairs = ((model.c1, model.time_constant), (model.c1_second, model.time_constant_second))
        self._parts = [
            [-c1 * math.expm1(-age / constant), constant / (constant + dt), dt / (constant + dt) * c1]
            for c1, constant in pairs
            if c1
        ]

    def value(self, temperature: float | None = None) -> float:
        """Return the present bias, rad/s. Raises ValueError if a required temperature is missing."""
        bias = self._base + sum(part[0] for part in self._parts)
        if self._coefficient:
            if temperature is None:
                raise ValueError("this warm-up model needs the temperature")
            bias += self._coefficient * (temperature - REFERENCE_CELSIUS)
        return bias

    def advance(self) -> None:
        """Advance to the next sample."""
        for part in self._parts:
            part[0] = part[1] * part[0] + part[2]
