"""Effects of the gyro triad: lag, scale, cross-axis, cubic, offsets, random walk, range and resolution."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import Effect, OdometryPrior, Visibility, parameter
from hubodo.effects.one_pole import one_pole
from hubodo.effects.sensor_chain import Noise, SensorChain
from hubodo.effects.triad import XYZ, CrossAxis, ScaleFactor, Sensor, multiply

_CUBIC_RATE_RANGE = 36.0  # rad/s, just beyond the widest range of the gyros, 2000 deg/s
_CUBIC_NEWTON_STEPS = 6  # converge to rounding errors for every cubic term that `why_irreversible` accepts
_G_SENSITIVITY_UNIT = "(rad/s)/(m/s²)"
_TWO_SPEEDS_ADVICE = "drive slowly and fast for the same time each"
_TURN_WHEEL_ADVICE = "drive on: the wheel must turn many multiply"
_CURVES_ADVICE = "drive curves: turns that add up to well over 180 degrees, to both sides"
_STANDSTILL_ADVICE = "stand still for ten seconds, and drive at several speeds"
COMMON_SCALE_SIGMA = 0.01
"""1 sigma of the scale error that the three gyros of a chip share: reference voltage and drive amplitude."""

_AXIS_SCALE_SIGMA = 0.007
"""1 sigma of the scale error of each axis beside the common one."""

_SCALE_ORIGIN = (
    "1 % common to the three axes of a chip and 0.7 % of each axis, together 40 % of the MPU-6050's "
    "tolerance; random walk: temperature, 0.012 % in an hour"
)
_SPIN_SCALE_PRIOR = OdometryPrior(
    math.hypot(COMMON_SCALE_SIGMA, _AXIS_SCALE_SIGMA), 2e-6, _SCALE_ORIGIN, _TURN_WHEEL_ADVICE
)
# The yaw rate alternates between x and y as the wheel turns: a drive shows the mean of both scales.
_YAW_SCALE_PRIOR = OdometryPrior(
    math.hypot(COMMON_SCALE_SIGMA, _AXIS_SCALE_SIGMA / math.sqrt(2.0)),
    2e-6,
    f"mean of x and y: {_SCALE_ORIGIN}",
    _CURVES_ADVICE,
)
_ZERO_RATE_ORIGIN = (
    "a third of the MPU-6050's zero-rate tolerance, 20 deg/s; random walk: temperature, 0.3 deg/s in an hour"
)
_GYRO_BIAS_ACROSS_PRIOR = OdometryPrior(0.1, 1e-4, _ZERO_RATE_ORIGIN, _TURN_WHEEL_ADVICE)
_GYRO_BIAS_ALONG_PRIOR = OdometryPrior(0.1, 1e-4, _ZERO_RATE_ORIGIN, _STANDSTILL_ADVICE)
# Gravity rotates in node axes, so the sensitivities xx and yy appear as a yaw rate of g (xx + yy) / 2.
_G_SENSITIVITY_PRIOR = OdometryPrior(
    1.2e-4 / STANDARD_GRAVITY,
    1e-6 / STANDARD_GRAVITY,
    "mean of xx and yy, 0.01 deg/s per g each, a tenth of the MPU-6050's limit; random walk: none, fixed",
)


@dataclass(frozen=True)
class GyroLag(Effect):
    """The gyro low-passes the rate with one pole."""

    name: ClassVar[str] = "gyro_lag"
    has_memory: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro lags behind the motion"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "time_offset": "change speed briskly: only a time offset delays the accelerometer too",
        "wheel_slip": "change speed briskly, and turn: only a lag delays gx and gy",
    }
    time_constant: float = parameter("s", 0.005, positive=True)

    def low_pass_rate(self, chain: SensorChain) -> None:
        # A negative lag is not physical, but a fit that starts at zero needs the derivative there.
        if self.time_constant > 1e-5:
            chain.rate = one_pole(chain.t, chain.rate, chain.rate_derivative, self.time_constant)
        else:
            chain.rate = chain.rate - self.time_constant * chain.rate_derivative


@dataclass(frozen=True)
class GyroScaleFactor(ScaleFactor):
    """Each gyro axis reads (1 + e) times the rate, with its own scale error e."""

    name: ClassVar[str] = "gyro_scale_factor"
    sensor: ClassVar[Sensor] = "gyro"
    meaning: ClassVar[str] = "the gyro has a scale error"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "tyre_growth": _TWO_SPEEDS_ADVICE,
        "gyro_cubic": _TWO_SPEEDS_ADVICE,
        "clock_skew": "change speed briskly: a clock skew delays every change",
    }
    x: float = parameter("1", 0.01, max_plausible=0.15, odometry_prior=_YAW_SCALE_PRIOR)
    y: float = parameter("1", 0.01, max_plausible=0.15, odometry_prior=_YAW_SCALE_PRIOR)
    z: float = parameter("1", 0.01, max_plausible=0.15, odometry_prior=_SPIN_SCALE_PRIOR)


@dataclass(frozen=True)
class GyroNonorthogonality(CrossAxis):
    """The gyro axes are not orthogonal: six cross-axis terms after Avrutov."""

    name: ClassVar[str] = "gyro_nonorthogonality"
    sensor: ClassVar[Sensor] = "gyro"
    meaning: ClassVar[str] = "the axes of the gyro are not orthogonal"


@dataclass(frozen=True)
class GyroCubic(Effect):
    """The z gyro has a cubic error: it reads c ω³ more, with rate ω and c = `z`."""

    name: ClassVar[str] = "gyro_cubic"
    is_invertible: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro is nonlinear at high rates"
    z: float = parameter("1/(rad/s)²", 1e-5, max_plausible=1e-3)

    def add_scale_errors(self, chain: SensorChain) -> None:
        chain.gyro[2] += self.z * chain.rate[2] ** 3

    def why_irreversible(self) -> str:
        if abs(3.0 * self.z * _CUBIC_RATE_RANGE**2) > 0.5:
            return f"z = {self.z:g} makes the reading ambiguous within the range of the gyro"
        return ""

    def remove_nonlinearity(self, rate: Array, inverse: Array) -> Array:
        # Solve w = rate - inverse[:, 2] c w_z³ for the true rate w: the z row is a cubic equation for w_z,
        # solved by Newton's method.
        spin, cubic = rate[2], inverse[2, 2] * self.z
        for _ in range(_CUBIC_NEWTON_STEPS):
            spin = spin - (spin + cubic * (spin * spin * spin) - rate[2]) / (
                1.0 + 3.0 * cubic * (spin * spin)
            )
        return rate - np.outer(inverse[:, 2], self.z * (spin * spin * spin))


@dataclass(frozen=True)
class GyroBias(Effect):
    """The gyro has a constant bias."""

    name: ClassVar[str] = "gyro_bias"
    varies_between_drives: ClassVar[bool] = True
    is_invertible: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro reads an offset"
    x: float = parameter("rad/s", 0.01, max_plausible=1.0, odometry_prior=_GYRO_BIAS_ACROSS_PRIOR)
    y: float = parameter(
        "rad/s", 0.01, max_plausible=1.0, flips_with_facing=True, odometry_prior=_GYRO_BIAS_ACROSS_PRIOR
    )
    z: float = parameter(
        "rad/s", 0.01, max_plausible=1.0, flips_with_facing=True, odometry_prior=_GYRO_BIAS_ALONG_PRIOR
    )

    def add_offsets(self, chain: SensorChain) -> None:
        chain.gyro += np.array([[self.x], [self.y], [self.z]])


@dataclass(frozen=True)
class GyroGSensitivity(Effect):
    """The gyros respond to the true specific force f.

    `x`, `y`, `z`: sensitivity of the z gyro to f_x, f_y, f_z. `xx` to `yz`: those of the x and y gyros, `xy`
    being the response of the x gyro to f_y. A bench calibration determines them; a drive hardly does, so they
    are not fitted to a drive.
    """

    name: ClassVar[str] = "gyro_g_sensitivity"
    is_invertible: ClassVar[bool] = True
    meaning: ClassVar[str] = "the gyro responds to acceleration"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "wheel_eccentricity": (
            "drive at two speeds: eccentricity grows with spin and shows in the accelerometer"
        ),
        "gyro_bias": "turn at speed: the force across the wheel changes, a bias does not",
    }
    x: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, max_plausible=0.05, flips_with_facing=True)
    y: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, max_plausible=0.05)
    z: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, max_plausible=0.05)
    xx: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, fitted=False, odometry_prior=_G_SENSITIVITY_PRIOR)
    xy: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, fitted=False, flips_with_facing=True)
    xz: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, fitted=False, flips_with_facing=True)
    yx: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, fitted=False, flips_with_facing=True)
    yy: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, fitted=False, odometry_prior=_G_SENSITIVITY_PRIOR)
    yz: float = parameter(_G_SENSITIVITY_UNIT, 1e-3, fitted=False)

    rows: ClassVar[tuple[tuple[str, str, str], ...]] = (("xx", "xy", "xz"), ("yx", "yy", "yz"), XYZ)
    """Names of the parameters: one row per gyro, one column per axis of the force."""

    def matrix(self) -> Array:
        """Return the (3, 3) sensitivities, one row per gyro, (rad/s)/(m/s²)."""
        return np.array([[getattr(self, name) for name in row] for row in self.rows])

    def add_offsets(self, chain: SensorChain) -> None:
        chain.gyro += multiply(self.matrix(), chain.force)


@dataclass(frozen=True)
class GyroRateRandomWalk(Effect):
    """The bias of each gyro axis is a random walk of k per square root of a second."""

    name: ClassVar[str] = "gyro_rate_random_walk"
    varies_between_drives: ClassVar[bool] = True
    visible_in: ClassVar[Visibility] = "scatter"
    meaning: ClassVar[str] = "the gyro's offset drifts at random"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "gyro_warmup": "record longer, and again from a cold start: a random walk does not repeat",
        "gyro_bias": "record longer: a random walk drifts away, a bias does not",
        "gyro_temperature": "let the temperature rise and fall again",
    }
    k: float = parameter("rad/s/√s", 5e-4, positive=True)

    def random_walk_variance_rate(self) -> float:
        return self.k**2

    def add_random_walk(self, chain: SensorChain, rng: np.random.Generator) -> None:
        steps = np.sqrt(np.diff(chain.t, prepend=chain.t[:1]).clip(0.0))
        chain.gyro += np.cumsum(self.k * steps * rng.standard_normal(chain.gyro.shape), axis=1)


@dataclass(frozen=True)
class GyroSaturation(Effect):
    """Gyro readings are clipped at ± limit; an infinite limit clips nothing."""

    name: ClassVar[str] = "gyro_saturation"
    visible_in: ClassVar[Visibility] = "scatter"
    meaning: ClassVar[str] = "the gyro saturates"
    limit: float = parameter("rad/s", 20.0, positive=True, default=math.inf)

    def clip_readings(self, chain: SensorChain) -> None:
        np.clip(chain.gyro, -self.limit, self.limit, out=chain.gyro)


@dataclass(frozen=True)
class GyroQuantization(Effect):
    """Gyro readings are rounded to multiples of a step."""

    name: ClassVar[str] = "gyro_quantization"
    visible_in: ClassVar[Visibility] = "scatter"
    meaning: ClassVar[str] = "the gyro has a coarse resolution"
    step: float = parameter("rad/s", 0.01, positive=True)

    def added_variance(self, noise: Noise) -> tuple[float, float]:
        return self.step**2 / 12.0, 0.0

    def quantize_readings(self, chain: SensorChain) -> None:
        if self.step > 0.0:
            chain.gyro = np.round(chain.gyro / self.step) * self.step
