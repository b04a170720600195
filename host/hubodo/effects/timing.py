"""Effects of time stamps and transport: delay, clock skew, repeated samples and outliers."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import log
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Effect, OdometryPrior, Visibility, parameter
from hubodo.effects.sensor_chain import Noise, SensorChain

# Prior probability that samples are stamped late: they are stamped when they arrive, after their transport.
_LATE_PROBABILITY = 0.75


@dataclass(frozen=True)
class TimeOffset(Effect):
    """A sample taken at t is stamped t + delay."""

    name: ClassVar[str] = "time_offset"
    varies_between_drives: ClassVar[bool] = True
    meaning: ClassVar[str] = "the samples are stamped late or early"
    delay: float = parameter(
        "s",
        0.01,
        max_plausible=0.5,
        odometry_prior=OdometryPrior(
            0.01,
            5e-5,
            "two nodes on one host's clock; random walk: error of the clock estimates, 3 ms in an hour",
        ),
    )

    def true_time(self, t: Array) -> Array:
        return t - self.delay

    def neg_log_prior(self) -> float:
        if not self.delay:
            return 0.0
        return -log(2.0 * (_LATE_PROBABILITY if self.delay > 0.0 else 1.0 - _LATE_PROBABILITY))


@dataclass(frozen=True)
class ClockSkew(Effect):
    """A sample taken at t is stamped t (1 + ppm 1e-6), with t from the start of the log."""

    name: ClassVar[str] = "clock_skew"
    varies_between_drives: ClassVar[bool] = True
    meaning: ClassVar[str] = "the node's clock runs fast or slow"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "time_offset": "record longer: the effect of a clock skew grows with time",
    }
    ppm: float = parameter("1e-6", 100.0, max_plausible=1e4, max_magnitude=5e5)

    def true_time(self, t: Array) -> Array:
        return t / (1.0 + 1e-6 * self.ppm)


@dataclass(frozen=True)
class SampleRepeat(Effect):
    """A sample repeats the values of its predecessor with a given probability."""

    name: ClassVar[str] = "sample_repeat"
    visible_in: ClassVar[Visibility] = "scatter"
    meaning: ClassVar[str] = "stale samples are sent again"
    confusable_with: ClassVar[Mapping[str, str]] = {
        "outliers": "search for samples that equal their predecessor: only repeats produce them",
    }
    probability: float = parameter("1", 0.01, positive=True, max_magnitude=1.0)

    def repeat_samples(self, chain: SensorChain, rng: np.random.Generator) -> None:
        fresh = rng.random(len(chain.t)) >= self.probability
        fresh[:1] = True
        source = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
        chain.gyro, chain.accel = chain.gyro[:, source], chain.accel[:, source]


@dataclass(frozen=True)
class Outliers(Effect):
    """A reading has an additional error of `sigma` times the noise with a given probability."""

    name: ClassVar[str] = "outliers"
    visible_in: ClassVar[Visibility] = "scatter"
    meaning: ClassVar[str] = "single readings are outliers"
    probability: float = parameter("1", 0.01, positive=True, max_magnitude=1.0)
    sigma: float = parameter("noise", 10.0, positive=True)

    def added_variance(self, noise: Noise) -> tuple[float, float]:
        variance_ratio = self.probability * self.sigma**2
        return variance_ratio * noise.gyro**2, variance_ratio * noise.accel**2

    def add_outliers(self, chain: SensorChain, noise: Noise, rng: np.random.Generator) -> None:
        for reading, sigma in ((chain.gyro, noise.gyro), (chain.accel, noise.accel)):
            is_outlier = rng.random(reading.shape) < self.probability
            reading += is_outlier * self.sigma * sigma * rng.standard_normal(reading.shape)
