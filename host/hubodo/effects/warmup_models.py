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
        """(N,) rad/s at t (N,) s since power-on. Raises ValueError where it needs the temperature."""
        made = self.c2 - self.c1 * np.expm1(-t / self.time_constant)
        made -= self.c1_second * np.expm1(-t / self.time_constant_second)
        if self.temperature_coefficient:
            if temperature is None:
                raise ValueError("this warm-up model needs the temperature")
            made += self.temperature_coefficient * (temperature - REFERENCE_CELSIUS)
        return made
