"""Effects of the gyro triad: lag, scale, cross-axis, curvature, offsets, limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import REFERENCE_CELSIUS, Chain, Effect, Estimate, Follows, Noise, Shows, parameter
from hubodo.effects.one_pole import one_pole
from hubodo.effects.triad import XYZ, CrossAxis, ScaleFactor, Sensor, times

_FASTEST = 36.0
"""rad/s, a little beyond the widest range of the gyros, 2000 deg/s."""
_NEWTON_STEPS = 6
_PER_FORCE = "(rad/s)/(m/s²)"
_TWO_SPEEDS = "drive slowly and fast for as long each"
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
    remembers: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro answers late"
    alike: ClassVar[Mapping[str, str]] = {
        "time_offset": "change speed briskly: the accelerometer is late only with the clock",
        "wheel_slip": "change speed briskly, and turn: only a lag shows across the axle",
    }
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
    sensor: ClassVar[Sensor] = "gyro"
    meaning: ClassVar[str] = "the gyro reads too much or too little, in proportion"
    alike: ClassVar[Mapping[str, str]] = {
        "tyre_growth": _TWO_SPEEDS,
        "gyro_cubic": _TWO_SPEEDS,
        "clock_skew": "change speed briskly: a skew is late at every change",
    }
    x: float = parameter("1", 0.01, estimate=_YAW_SCALE)
    y: float = parameter("1", 0.01, estimate=_YAW_SCALE)
    z: float = parameter("1", 0.01, estimate=_SPIN_SCALE)


@dataclass(frozen=True)
class GyroNonorthogonality(CrossAxis):
    """Cross-axis terms of the gyro after Avrutov."""

    name: ClassVar[str] = "gyro_nonorthogonality"
    sensor: ClassVar[Sensor] = "gyro"
    meaning: ClassVar[str] = "the axes of the gyro are not square"


@dataclass(frozen=True)
class GyroCubic(Effect):
    """The z gyro reads c ω³ more."""

    name: ClassVar[str] = "gyro_cubic"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro bends at high rates"
    z: float = parameter("1/(rad/s)²", 1e-5)

    def respond(self, chain: Chain) -> None:
        chain.gyro[2] += self.z * chain.rate[2] ** 3

    def irreversible(self) -> str:
        if abs(3.0 * self.z * _FASTEST**2) > 0.5:
            return f"z = {self.z:g} would turn the scale around within the range of the gyro"
        return ""

    def straighten(self, rate: Array, inverse: Array) -> Array:
        # w = rate - inverse[:, 2] c w_z³; its z row alone is a cubic for w_z, by Newton's steps.
        spin, cubic = rate[2], inverse[2, 2] * self.z
        for _ in range(_NEWTON_STEPS):
            spin = spin - (spin + cubic * (spin * spin * spin) - rate[2]) / (
                1.0 + 3.0 * cubic * (spin * spin)
            )
        return rate - np.outer(inverse[:, 2], self.z * (spin * spin * spin))


@dataclass(frozen=True)
class GyroBias(Effect):
    """A constant offset."""

    name: ClassVar[str] = "gyro_bias"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro reads an offset"
    x: float = parameter("rad/s", 0.01, estimate=_BIAS_ACROSS)
    y: float = parameter("rad/s", 0.01, turned=True, estimate=_BIAS_ACROSS)
    z: float = parameter("rad/s", 0.01, turned=True, estimate=_BIAS_ALONG)

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]])


@dataclass(frozen=True)
class GyroTemperature(Effect):
    """An offset in proportion to the temperature above 25 °C."""

    name: ClassVar[str] = "gyro_temperature"
    follows: ClassVar[Follows | None] = "temperature"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro's offset follows the temperature"
    alike: ClassVar[Mapping[str, str]] = {
        "gyro_bias": "let the temperature change by some degrees",
    }
    x: float = parameter("rad/s/°C", 1e-3)
    y: float = parameter("rad/s/°C", 1e-3, turned=True)
    z: float = parameter("rad/s/°C", 1e-3, turned=True)

    def offset(self, chain: Chain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]]) * (chain.temperature - REFERENCE_CELSIUS)


@dataclass(frozen=True)
class GyroGSensitivity(Effect):
    """How the gyros answer the true specific force.

    x, y, z: the z gyro along x, y, z. xx to yz: the x and y gyros, xy how the x gyro answers f_y; a bench
    calibration knows them, a drive shows little of them, so no fit to a drive moves them.
    """

    name: ClassVar[str] = "gyro_g_sensitivity"
    undone: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro feels acceleration"
    alike: ClassVar[Mapping[str, str]] = {
        "wheel_eccentricity": (
            "drive at two speeds: eccentricity grows with spin and shows in the accelerometer"
        ),
        "gyro_bias": "turn at speed: the force across the wheel changes, a bias does not",
    }
    x: float = parameter(_PER_FORCE, 1e-3, turned=True)
    y: float = parameter(_PER_FORCE, 1e-3)
    z: float = parameter(_PER_FORCE, 1e-3)
    xx: float = parameter(_PER_FORCE, 1e-3, fitted=False, estimate=_FROM_GRAVITY)
    xy: float = parameter(_PER_FORCE, 1e-3, fitted=False, turned=True)
    xz: float = parameter(_PER_FORCE, 1e-3, fitted=False, turned=True)
    yx: float = parameter(_PER_FORCE, 1e-3, fitted=False, turned=True)
    yy: float = parameter(_PER_FORCE, 1e-3, fitted=False, estimate=_FROM_GRAVITY)
    yz: float = parameter(_PER_FORCE, 1e-3, fitted=False)

    rows: ClassVar[tuple[tuple[str, str, str], ...]] = (("xx", "xy", "xz"), ("yx", "yy", "yz"), XYZ)
    """Parameters by gyro and axis of the force."""

    def matrix(self) -> Array:
        """(3, 3), row = gyro."""
        return np.array([[getattr(self, name) for name in row] for row in self.rows])

    def offset(self, chain: Chain) -> None:
        chain.gyro += times(self.matrix(), chain.force)


@dataclass(frozen=True)
class GyroRateRandomWalk(Effect):
    """Each axis drifts by k per square root of a second."""

    name: ClassVar[str] = "gyro_rate_random_walk"
    shows: ClassVar[Shows] = "scatter"
    meaning: ClassVar[str] = "the gyro's offset wanders at random"
    alike: ClassVar[Mapping[str, str]] = {
        "gyro_warmup": "record longer, and again from a cold start: a walk does not repeat itself",
        "gyro_bias": "record longer: a walk leaves where it was",
        "gyro_temperature": "let the temperature go up and come back",
    }
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
    meaning: ClassVar[str] = "the gyro cannot read rates beyond a limit"
    limit: float = parameter("rad/s", 20.0, positive=True, default=math.inf)

    def clip(self, chain: Chain) -> None:
        np.clip(chain.gyro, -self.limit, self.limit, out=chain.gyro)


@dataclass(frozen=True)
class GyroQuantization(Effect):
    """Rounded to whole steps."""

    name: ClassVar[str] = "gyro_quantization"
    shows: ClassVar[Shows] = "scatter"
    meaning: ClassVar[str] = "the gyro reads in coarse steps"
    step: float = parameter("rad/s", 0.01, positive=True)

    def spread(self, noise: Noise) -> tuple[float, float]:
        return self.step**2 / 12.0, 0.0

    def digitize(self, chain: Chain) -> None:
        if self.step > 0.0:
            chain.gyro = np.round(chain.gyro / self.step) * self.step
