"""Effects of the gyro triad: lag, scale, cross-axis, curvature, offsets, limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Chain, Effect, Noise, Shows, parameter
from hubodo.effects.one_pole import one_pole
from hubodo.effects.triad import CrossAxis, ScaleFactor


@dataclass(frozen=True)
class GyroLag(Effect):
    """A low-pass of one pole in the gyro."""

    name: ClassVar[str] = "gyro_lag"
    time_constant: float = parameter("s", 0.005, positive=True)

    def low_pass(self, chain: Chain) -> None:
        # A negative lag means nothing in the world, but a fit that starts at zero needs the slope there.
        if self.time_constant > 1e-5:
            chain.rate = one_pole(chain.t, chain.rate, chain.rate_derivative, self.time_constant)
        else:
            chain.rate = chain.rate - self.time_constant * chain.rate_derivative


@dataclass(frozen=True)
class GyroScaleFactor(ScaleFactor):
    """Reads (1 + e) times the rate, each axis its own e."""

    name: ClassVar[str] = "gyro_scale_factor"

    def respond(self, chain: Chain) -> None:
        chain.gyro += self.more(chain.rate)


@dataclass(frozen=True)
class GyroNonorthogonality(CrossAxis):
    """Cross-axis terms of the gyro after Avrutov."""

    name: ClassVar[str] = "gyro_nonorthogonality"

    def respond(self, chain: Chain) -> None:
        chain.gyro += self.matrix() @ chain.rate


@dataclass(frozen=True)
class GyroCubic(Effect):
    """The z gyro reads c ω³ more."""

    name: ClassVar[str] = "gyro_cubic"
    z: float = parameter("1/(rad/s)²", 1e-5)

    def respond(self, chain: Chain) -> None:
        chain.gyro[2] += self.z * chain.rate[2] ** 3


@dataclass(frozen=True)
class GyroBias(Effect):
    """A constant offset."""

    name: ClassVar[str] = "gyro_bias"
    x: float = parameter("rad/s", 0.01)
    y: float = parameter("rad/s", 0.01)
    z: float = parameter("rad/s", 0.01)

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]])


@dataclass(frozen=True)
class GyroWarmup(Effect):
    """C1 (1 - e^(-t/T)) with t since power-on.

    Coordinates: C1 of each axis and ln T, so that T stays positive.
    """

    name: ClassVar[str] = "gyro_warmup"
    x: float = parameter("rad/s", 0.01)
    y: float = parameter("rad/s", 0.01)
    z: float = parameter("rad/s", 0.01)
    time_constant: float = parameter("s", 60.0, positive=True, default=60.0)

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
        return GyroWarmup(x, y, z, math.exp(min(max(log_t, math.log(2.0)), math.log(1e5))))

    def surprise(self) -> float:
        """A minute is usual, a factor of three is not rare; else a warm-up could pass for a bias or a ramp.

        The chance of one that is at least as unusual.
        """
        off = abs(math.log(self.time_constant / 60.0)) / math.log(3.0)
        return -math.log(max(math.erfc(off / math.sqrt(2.0)), 1e-300))

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]]) * -np.expm1(-chain.t / self.time_constant)


@dataclass(frozen=True)
class GyroTemperature(Effect):
    """An offset in proportion to the temperature above 25 °C."""

    name: ClassVar[str] = "gyro_temperature"
    x: float = parameter("rad/s/°C", 1e-3)
    y: float = parameter("rad/s/°C", 1e-3)
    z: float = parameter("rad/s/°C", 1e-3)

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]]) * (chain.temperature - 25.0)


@dataclass(frozen=True)
class GyroGSensitivity(Effect):
    """How the z gyro answers the true specific force along x, y, z."""

    name: ClassVar[str] = "gyro_g_sensitivity"
    x: float = parameter("(rad/s)/(m/s²)", 1e-3)
    y: float = parameter("(rad/s)/(m/s²)", 1e-3)
    z: float = parameter("(rad/s)/(m/s²)", 1e-3)

    def offset(self, chain: Chain) -> None:
        chain.gyro[2] += np.array([self.x, self.y, self.z]) @ chain.force


@dataclass(frozen=True)
class GyroRateRandomWalk(Effect):
    """Each axis drifts by k per square root of a second."""

    name: ClassVar[str] = "gyro_rate_random_walk"
    shows: ClassVar[Shows] = "scatter"
    k: float = parameter("rad/s/√s", 5e-4, positive=True)

    def drift(self) -> float:
        return self.k**2

    def wander(self, chain: Chain, rng: np.random.Generator) -> None:
        steps = np.sqrt(np.diff(chain.t, prepend=chain.t[:1]).clip(0.0))
        chain.gyro += np.cumsum(self.k * steps * rng.standard_normal(chain.gyro.shape), axis=1)


@dataclass(frozen=True)
class GyroSaturation(Effect):
    """Nothing beyond ± limit is read; without a limit (infinity) everything is."""

    name: ClassVar[str] = "gyro_saturation"
    shows: ClassVar[Shows] = "scatter"
    limit: float = parameter("rad/s", 20.0, positive=True, default=math.inf)

    def clip(self, chain: Chain) -> None:
        np.clip(chain.gyro, -self.limit, self.limit, out=chain.gyro)


@dataclass(frozen=True)
class GyroQuantization(Effect):
    """Rounded to whole steps."""

    name: ClassVar[str] = "gyro_quantization"
    shows: ClassVar[Shows] = "scatter"
    step: float = parameter("rad/s", 0.01, positive=True)

    def spread(self, noise: Noise) -> tuple[float, float]:
        return self.step**2 / 12.0, 0.0

    def digitize(self, chain: Chain) -> None:
        if self.step > 0.0:
            chain.gyro = np.round(chain.gyro / self.step) * self.step
