"""Warm-up of the gyro bias: the effect, and the models that are fitted to one axis at standstill."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Dependency, Effect, parameter
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS, SensorChain


def warmup_fraction(age: Array, time_constant: float) -> Array:
    """Return the completed fraction of a warm-up, 1 - e^(-age / T), (N,); age and time constant T in s."""
    return np.asarray(-np.expm1(-age / time_constant))


@dataclass(frozen=True)
class GyroWarmup(Effect):
    """The gyro bias settles exponentially after power-on: C1 (1 - e^(-t/T)), with time t since power-on.

    A bench record may show a second exponential; a drive cannot separate the two, so only the first is fitted
    to a drive. The second one is absent where its time constant is 0. The coordinates of a fit are C1 of each
    axis and ln T, which keeps T positive.
    """

    name: ClassVar[str] = "gyro_warmup"
    varies_between_drives: ClassVar[bool] = True
    depends_on: ClassVar[Dependency | None] = "age"
    is_invertible: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro's offset settles after power-on"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "gyro_temperature": "record from power-on with the temperature going up and down",
        "gyro_bias": "record from power-on, several times as long as the warm-up takes",
    }
    x: float = parameter("rad/s", 0.01)
    y: float = parameter("rad/s", 0.01, flips_with_facing=True)
    z: float = parameter("rad/s", 0.01, flips_with_facing=True)
    time_constant: float = parameter("s", 60.0, positive=True, default=60.0)
    x_second: float = parameter("rad/s", 0.01, fitted=False)
    y_second: float = parameter("rad/s", 0.01, flips_with_facing=True, fitted=False)
    z_second: float = parameter("rad/s", 0.01, flips_with_facing=True, fitted=False)
    time_constant_second: float = parameter("s", 600.0, positive=True, fitted=False)

    @classmethod
    def initial_guesses(cls) -> tuple[GyroWarmup, ...]:
        return tuple(cls(time_constant=t) for t in (8.0, 25.0, 80.0, 250.0, 1000.0))

    @classmethod
    def coordinate_scales(cls) -> Array:
        return np.array([cls.scale("x"), cls.scale("y"), cls.scale("z"), 1.5])

    def coordinates(self) -> Array:
        return np.array([self.x, self.y, self.z, math.log(self.time_constant)])

    def with_coordinates(self, coordinates: Array) -> GyroWarmup:
        x, y, z, log_t = map(float, coordinates)
        constant = math.exp(min(max(log_t, math.log(2.0)), math.log(1e5)))
        return replace(self, x=x, y=y, z=z, time_constant=constant)

    def neg_log_prior(self) -> float:
        """Return -ln of the two-sided tail probability of the time constant under a log-normal prior.

        Median one minute, 1σ a factor of three. Without this prior a warm-up could fit any bias or ramp.
        """
        sigmas = abs(math.log(self.time_constant / 60.0)) / math.log(3.0)
        return -math.log(max(math.erfc(sigmas / math.sqrt(2.0)), 1e-300))

    def add_offsets(self, chain: SensorChain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]]) * warmup_fraction(chain.t, self.time_constant)
        if self.time_constant_second > 0.0:
            second = np.array([[self.x_second], [self.y_second], [self.z_second]])
            chain.gyro += second * warmup_fraction(chain.t, self.time_constant_second)

    def why_irreversible(self) -> str:
        if self.time_constant_second == 0.0 and any((self.x_second, self.y_second, self.z_second)):
            return "has a second exponential but no time_constant_second"
        return ""


WarmupKind = Literal[
    "exponential",
    "two exponentials",
    "exponential and temperature",
    "temperature",
    "quadratic temperature",
    "cubic temperature",
    "exponential and quadratic temperature",
]

TEMPERATURE_PARAMETERS = ("temperature_coefficient", "temperature_quadratic", "temperature_cubic")
"""Coefficients of the temperature difference from 25 °C, by increasing power."""

WARMUP_PARAMETERS: dict[WarmupKind, tuple[str, ...]] = {
    "exponential": ("c2", "c1", "time_constant"),
    "two exponentials": ("c2", "c1", "time_constant", "c1_second", "time_constant_second"),
    "exponential and temperature": ("c2", "c1", "time_constant", "temperature_coefficient"),
    "temperature": ("c2", "temperature_coefficient"),
    "quadratic temperature": ("c2", *TEMPERATURE_PARAMETERS[:2]),
    "cubic temperature": ("c2", *TEMPERATURE_PARAMETERS),
    "exponential and quadratic temperature": ("c2", "c1", "time_constant", *TEMPERATURE_PARAMETERS[:2]),
}
"""Parameters of each warm-up model, in the order of the fit."""


@dataclass(frozen=True)
class WarmupModel:
    """Gyro bias during warm-up: c2 + c1 (1 - e^(-t/T)) [+ c1' (1 - e^(-t/T'))] [+ sum of k_n D^n].

    D is the difference of the temperature from 25 °C.

    The first exponential is eq. (1) of Barshan and Durrant-Whyte; t is the time since power-on.

    Attributes
    ----------
    c2 : rad/s, bias at power-on.
    c1, time_constant : rad/s and s, amplitude and T of the first exponential.
    c1_second, time_constant_second : rad/s and s, amplitude c1' and T' of the second exponential.
    temperature_coefficient, temperature_quadratic, temperature_cubic : (rad/s)/°C^n, k_n.
    """

    c2: float
    c1: float = 0.0
    time_constant: float = math.inf
    c1_second: float = 0.0
    time_constant_second: float = math.inf
    temperature_coefficient: float = 0.0
    temperature_quadratic: float = 0.0
    temperature_cubic: float = 0.0

    def bias(self, t: Array, temperature: Array | None = None) -> Array:
        """Return the bias in rad/s, (N,), at t (N,) s since power-on.

        temperature: (N,) °C. Raise ValueError if the model needs a temperature and none is given.
        """
        bias = self.c2 + self.c1 * warmup_fraction(t, self.time_constant)
        if self.c1_second:
            bias += self.c1_second * warmup_fraction(t, self.time_constant_second)
        coefficients = self.temperature_coefficient, self.temperature_quadratic, self.temperature_cubic
        for n, coefficient in enumerate(coefficients):
            if coefficient:
                if temperature is None:
                    raise ValueError("this warm-up model needs the temperature")
                bias += coefficient * (temperature - REFERENCE_CELSIUS) ** (n + 1)
        return bias
