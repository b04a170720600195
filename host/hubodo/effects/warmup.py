"""The bias of a gyro that warms up: the effect, and the models that are fitted to one axis at rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import REFERENCE_CELSIUS, Chain, Effect, Follows, parameter


def warmed(age: Array, time_constant: float) -> Array:
    """1 - e^(-age / T), (N,): how much of a warm-up has passed after so many s, T in s."""
    return np.asarray(-np.expm1(-age / time_constant))


@dataclass(frozen=True)
class GyroWarmup(Effect):
    """C1 (1 - e^(-t/T)) with t since power-on, and where a bench record shows it a second one beside it.

    Coordinates: C1 of each axis and ln T, so that T stays positive. A drive does not tell two exponentials
    apart, so no fit to one moves the second, which is absent where its time constant is 0.
    """

    name: ClassVar[str] = "gyro_warmup"
    follows: ClassVar[Follows | None] = "age"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro's offset settles after power-on"
    alike: ClassVar[Mapping[str, str]] = {
        "gyro_temperature": "record from power-on with the temperature going up and down",
        "gyro_bias": "record from power-on, several times as long as the warm-up takes",
    }
    x: float = parameter("rad/s", 0.01)
    y: float = parameter("rad/s", 0.01, turned=True)
    z: float = parameter("rad/s", 0.01, turned=True)
    time_constant: float = parameter("s", 60.0, positive=True, default=60.0)
    x_second: float = parameter("rad/s", 0.01, fitted=False)
    y_second: float = parameter("rad/s", 0.01, turned=True, fitted=False)
    z_second: float = parameter("rad/s", 0.01, turned=True, fitted=False)
    time_constant_second: float = parameter("s", 600.0, positive=True, fitted=False)

    @classmethod
    def seeds(cls) -> tuple[GyroWarmup, ...]:
        return tuple(cls(time_constant=t) for t in (8.0, 25.0, 80.0, 250.0, 1000.0))

    @classmethod
    def coordinate_scales(cls) -> Array:
        return np.array([cls.scale("x"), cls.scale("y"), cls.scale("z"), 1.5])

    def coordinates(self) -> Array:
        return np.array([self.x, self.y, self.z, math.log(self.time_constant)])

    def at(self, coordinates: Array) -> GyroWarmup:
        x, y, z, log_t = map(float, coordinates)
        constant = math.exp(min(max(log_t, math.log(2.0)), math.log(1e5)))
        return replace(self, x=x, y=y, z=z, time_constant=constant)

    def surprise(self) -> float:
        """A minute is usual, a factor of three is not rare; else a warm-up could pass for a bias or a ramp.

        The chance of one that is at least as unusual.
        """
        off = abs(math.log(self.time_constant / 60.0)) / math.log(3.0)
        return -math.log(max(math.erfc(off / math.sqrt(2.0)), 1e-300))

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]]) * warmed(chain.t, self.time_constant)
        if self.time_constant_second > 0.0:
            second = np.array([[self.x_second], [self.y_second], [self.z_second]])
            chain.gyro += second * warmed(chain.t, self.time_constant_second)

    def irreversible(self) -> str:
        if self.time_constant_second == 0.0 and any((self.x_second, self.y_second, self.z_second)):
            return "has a second exponential without time_constant_second"
        return ""


Kind = Literal["exponential", "two exponentials", "exponential and temperature", "temperature"]

PARAMETERS: dict[Kind, tuple[str, ...]] = {
    "exponential": ("c2", "c1", "time_constant"),
    "two exponentials": ("c2", "c1", "time_constant", "c1_second", "time_constant_second"),
    "exponential and temperature": ("c2", "c1", "time_constant", "temperature_coefficient"),
    "temperature": ("c2", "temperature_coefficient"),
}
"""Parameters of each model in the order of the fit."""


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

    def bias(self, t: Array, temperature: Array | None = None) -> Array:
        """(N,) rad/s at t (N,) s since power-on. Raises ValueError when a needed temperature is not given."""
        made = self.c2 + self.c1 * warmed(t, self.time_constant)
        if self.c1_second:
            made += self.c1_second * warmed(t, self.time_constant_second)
        if self.temperature_coefficient:
            if temperature is None:
                raise ValueError("this warm-up model needs the temperature")
            made += self.temperature_coefficient * (temperature - REFERENCE_CELSIUS)
        return made
