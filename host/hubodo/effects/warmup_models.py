"""The bias of a gyro that warms up, as functions of time since power-on and temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Kind = Literal["exponential", "two exponentials", "exponential and temperature", "temperature"]

PARAMETERS: dict[Kind, tuple[str, ...]] = {
    "exponential": ("c2", "c1", "time_constant"),
    "two exponentials": ("c2", "c1", "time_constant", "c1_second", "time_constant_second"),
    "exponential and temperature": ("c2", "c1", "time_constant", "temperature_coefficient"),
    "temperature": ("c2", "temperature_coefficient"),
}
"""Parameters of each model in the order of the fit."""

REFERENCE_CELSIUS = 25.0
"""Temperature at which the temperature term is zero, as in the forward model."""


@dataclass(frozen=True)
class WarmupModel:
    """Bias = c2 + c1 (1 - e^(-t/T)) [+ c1' (1 - e^(-t/T'))] [+ k (temperature - 25 C)].

    The first exponential is eq. (1) of Barshan and Durrant-Whyte.

    c1, c2, c1_second: rad/s; time_constant, time_constant_second: s; temperature_coefficient: rad/s per
    degree C.
    """

    c2: float
    c1: float = 0.0
    time_constant: float = math.inf
    c1_second: float = 0.0
    time_constant_second: float = math.inf
    temperature_coefficient: float = 0.0

    def bias(self, t: FloatArray, temperature: FloatArray | None = None) -> FloatArray:
        """(N,) rad/s at t (N,) s since power-on. Raises ValueError when the temperature is needed and not "
        "given."""
        made = self.c2 - self.c1 * np.expm1(-t / self.time_constant)
        made -= self.c1_second * np.expm1(-t / self.time_constant_second)
        if self.temperature_coefficient:
            if temperature is None:
                raise ValueError("this warm-up model needs the temperature")
            made += self.temperature_coefficient * (temperature - REFERENCE_CELSIUS)
        return made


class BiasRecursion:
    """The bias sample by sample, as a filter or a node keeps it: eq. (6) of the paper, started at any age.

    eps(k + 1) = T / (T + dt) eps(k) + dt / (T + dt) (C1 + C2), for each exponential; the temperature term is
    added outside. age: seconds since power-on at the first sample.
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
        """Bias of the present sample, rad/s. Raises ValueError when the temperature is needed and not "
        "given."""
        bias = self._base + sum(part[0] for part in self._parts)
        if self._coefficient:
            if temperature is None:
                raise ValueError("this warm-up model needs the temperature")
            bias += self._coefficient * (temperature - REFERENCE_CELSIUS)
        return bias

    def advance(self) -> None:
        """On to the next sample."""
        for part in self._parts:
            part[0] = part[1] * part[0] + part[2]
