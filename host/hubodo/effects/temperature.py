"""Effects of the temperature: polynomials of the biases, and linear changes of the scales."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Dependency, Effect, parameter
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS, SensorChain
from hubodo.effects.triad import XYZ, Sensor

POLYNOMIAL_SUFFIXES = ("", "_quadratic", "_cubic")
"""Suffixes of the parameters of a polynomial, by increasing power of the temperature."""


@dataclass(frozen=True)
class BiasPolynomial(Effect):
    """A bias that is a polynomial of the difference of the temperature from 25 °C."""

    depends_on: ClassVar[Dependency | None] = "temperature"
    is_invertible: ClassVar[bool] = True
    varies_between_drives: ClassVar[bool] = True
    sensor: ClassVar[Sensor]

    def bias(self, temperature: Array) -> Array:
        """Return the bias, (3, N), at temperatures (N,) °C."""
        warmth = temperature - REFERENCE_CELSIUS
        linear, quadratic, cubic = (
            np.array([[getattr(self, axis + suffix)] for axis in XYZ]) for suffix in POLYNOMIAL_SUFFIXES
        )
        if not (quadratic.any() or cubic.any()):
            return np.asarray(linear * warmth)
        return np.asarray(((cubic * warmth + quadratic) * warmth + linear) * warmth)

    def add_offsets(self, chain: SensorChain) -> None:
        if self.sensor == "gyro":
            chain.gyro += self.bias(chain.temperature)
        else:
            chain.accel += self.bias(chain.temperature)


@dataclass(frozen=True)
class GyroTemperature(BiasPolynomial):
    """The gyro bias is a polynomial of the temperature difference from 25 °C.

    A drive shows no more than the linear terms; the others come from a bench record.
    """

    name: ClassVar[str] = "gyro_temperature"
    sensor: ClassVar[Sensor] = "gyro"
    meaning: ClassVar[str] = "the gyro's offset follows the temperature"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "gyro_bias": "let the temperature change by several degrees",
    }
    x: float = parameter("rad/s/°C", 1e-3, max_plausible=0.1)
    y: float = parameter("rad/s/°C", 1e-3, max_plausible=0.1, flips_with_facing=True)
    z: float = parameter("rad/s/°C", 1e-3, max_plausible=0.1, flips_with_facing=True)
    x_quadratic: float = parameter("rad/s/°C²", 2e-5, fitted=False)
    y_quadratic: float = parameter("rad/s/°C²", 2e-5, flips_with_facing=True, fitted=False)
    z_quadratic: float = parameter("rad/s/°C²", 2e-5, flips_with_facing=True, fitted=False)
    x_cubic: float = parameter("rad/s/°C³", 1e-6, fitted=False)
    y_cubic: float = parameter("rad/s/°C³", 1e-6, flips_with_facing=True, fitted=False)
    z_cubic: float = parameter("rad/s/°C³", 1e-6, flips_with_facing=True, fitted=False)


@dataclass(frozen=True)
class AccelTemperature(BiasPolynomial):
    """The accelerometer bias is a polynomial of the temperature difference from 25 °C.

    It comes from a bench record; a drive does not separate it from the other biases.
    """

    name: ClassVar[str] = "accel_temperature"
    sensor: ClassVar[Sensor] = "accel"
    meaning: ClassVar[str] = "the accelerometer's offset follows the temperature"
    x: float = parameter("m/s²/°C", 1e-2, fitted=False)
    y: float = parameter("m/s²/°C", 1e-2, flips_with_facing=True, fitted=False)
    z: float = parameter("m/s²/°C", 1e-2, flips_with_facing=True, fitted=False)
    x_quadratic: float = parameter("m/s²/°C²", 2e-4, fitted=False)
    y_quadratic: float = parameter("m/s²/°C²", 2e-4, flips_with_facing=True, fitted=False)
    z_quadratic: float = parameter("m/s²/°C²", 2e-4, flips_with_facing=True, fitted=False)
    x_cubic: float = parameter("m/s²/°C³", 1e-5, fitted=False)
    y_cubic: float = parameter("m/s²/°C³", 1e-5, flips_with_facing=True, fitted=False)
    z_cubic: float = parameter("m/s²/°C³", 1e-5, flips_with_facing=True, fitted=False)


@dataclass(frozen=True)
class ScaleTemperature(Effect):
    """Scale errors that are proportional to the temperature difference from 25 °C."""

    depends_on: ClassVar[Dependency | None] = "temperature"
    is_invertible: ClassVar[bool] = True
    sensor: ClassVar[Sensor]
    x: float = parameter("1/°C", 1e-4, max_plausible=2e-3, fitted=False)
    y: float = parameter("1/°C", 1e-4, max_plausible=2e-3, fitted=False)
    z: float = parameter("1/°C", 1e-4, max_plausible=2e-3, fitted=False)

    def scale_errors(self, temperature: Array) -> Array:
        """Return the scale errors, (3, N), at temperatures (N,) °C."""
        return np.array([[self.x], [self.y], [self.z]]) * (temperature - REFERENCE_CELSIUS)

    def add_scale_errors(self, chain: SensorChain) -> None:
        if self.sensor == "gyro":
            chain.gyro += self.scale_errors(chain.temperature) * chain.rate
        else:
            chain.accel += self.scale_errors(chain.temperature) * chain.force


@dataclass(frozen=True)
class GyroScaleTemperature(ScaleTemperature):
    """The scale of each gyro axis changes with the temperature difference from 25 °C."""

    name: ClassVar[str] = "gyro_scale_temperature"
    sensor: ClassVar[Sensor] = "gyro"
    meaning: ClassVar[str] = "the gyro's scale follows the temperature"


@dataclass(frozen=True)
class AccelScaleTemperature(ScaleTemperature):
    """The scale of each accelerometer axis changes with the temperature difference from 25 °C."""

    name: ClassVar[str] = "accel_scale_temperature"
    sensor: ClassVar[Sensor] = "accel"
    meaning: ClassVar[str] = "the accelerometer's scale follows the temperature"
