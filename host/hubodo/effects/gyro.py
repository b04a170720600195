"""Effects of the gyro triad: lag, scale, cross-axis, curvature, offsets, limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import Chain, Effect, Estimate, Noise, Shows, parameter
from hubodo.effects.one_pole import one_pole
from hubodo.effects.triad import CrossAxis, ScaleFactor

_PER_FORCE = "(rad/s)/(m/s²)"
_TURN = "drive on: the wheel must turn many times"
_CURVES = "drive curves: turns that add up to well over 180 degrees, to both sides"
_STAND = "stand still for ten seconds, and drive at several speeds"
_SPIN_SCALE = Estimate(
    0.015, 2e-6, "half of what the MPU-6050 may be off, 3 %; walk: temperature, 0.012 % in an hour", _TURN
)
# Turns of the vehicle pass from x to y and back as the wheel turns: a drive shows the mean of both scales.
_YAW_SCALE = Estimate(
    0.0075, 2e-6, "of the mean of x and y, 1 % each; walk: temperature, 0.012 % in an hour", _CURVES
)
_BIAS_ORIGIN = (
    "a third of the MPU-6050's zero-rate tolerance, 20 deg/s; walk: temperature, 0.3 deg/s in an hour"
)
_BIAS_ACROSS = Estimate(0.1, 1e-4, _BIAS_ORIGIN, _TURN)
_BIAS_ALONG = Estimate(0.1, 1e-4, _BIAS_ORIGIN, _STAND)
# Gravity turns with the wheel, so what it makes in x and y is a yaw rate of g (xx + yy) / 2.
_FROM_GRAVITY = Estimate(
    1.2e-4 / STANDARD_GRAVITY,
    1e-6 / STANDARD_GRAVITY,
    "of the mean of xx and yy, 0.01 deg/s per g each, a tenth of the MPU-6050's limit; walk: it is fixed",
)


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
    x: float = parameter("1", 0.01, estimate=_YAW_SCALE)
    y: float = parameter("1", 0.01, estimate=_YAW_SCALE)
    z: float = parameter("1", 0.01, estimate=_SPIN_SCALE)

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
    x: float = parameter("rad/s", 0.01, estimate=_BIAS_ACROSS)
    y: float = parameter("rad/s", 0.01, turned=True, estimate=_BIAS_ACROSS)
    z: float = parameter("rad/s", 0.01, turned=True, estimate=_BIAS_ALONG)

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]])


@dataclass(frozen=True)
class GyroWarmup(Effect):
    """C1 (1 - e^(-t/T)) with t since power-on.

    Coordinates: C1 of each axis and ln T, so that T stays positive.
    """

    name: ClassVar[str] = "gyro_warmup"
    x: float = parameter("rad/s", 0.01)
    y: float = parameter("rad/s", 0.01, turned=True)
    z: float = parameter("rad/s", 0.01, turned=True)
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
    y: float = parameter("rad/s/°C", 1e-3, turned=True)
    z: float = parameter("rad/s/°C", 1e-3, turned=True)

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]]) * (chain.temperature - 25.0)


@dataclass(frozen=True)
class GyroGSensitivity(Effect):
    """How the gyros answer the true specific force.

    x, y, z: the z gyro along x, y, z. xx to yz: the x and y gyros, xy how the x gyro answers f_y; a bench
    calibration knows them, a drive shows little of them, so no fit to a drive moves them.
    """

    name: ClassVar[str] = "gyro_g_sensitivity"
    x: float = parameter(_PER_FORCE, 1e-3, turned=True)
    y: float = parameter(_PER_FORCE, 1e-3)
    z: float = parameter(_PER_FORCE, 1e-3)
    xx: float = parameter(_PER_FORCE, 1e-3, fitted=False, estimate=_FROM_GRAVITY)
    xy: float = parameter(_PER_FORCE, 1e-3, fitted=False, turned=True)
    xz: float = parameter(_PER_FORCE, 1e-3, fitted=False, turned=True)
    yx: float = parameter(_PER_FORCE, 1e-3, fitted=False, turned=True)
    yy: float = parameter(_PER_FORCE, 1e-3, fitted=False, estimate=_FROM_GRAVITY)
    yz: float = parameter(_PER_FORCE, 1e-3, fitted=False)

    def matrix(self) -> Array:
        """(3, 3), row = gyro."""
        return np.array([[self.xx, self.xy, self.xz], [self.yx, self.yy, self.yz], [self.x, self.y, self.z]])

    def offset(self, chain: Chain) -> None:
        chain.gyro += self.matrix() @ chain.force


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
