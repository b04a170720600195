"""Effects of time stamps and of transport: late, skewed, repeated, wild samples."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Chain, Effect, Estimate, Noise, Shows, parameter


@dataclass(frozen=True)
class TimeOffset(Effect):
    """A sample taken at t is stamped t + delay."""

    name: ClassVar[str] = "time_offset"
    meaning: ClassVar[str] = "the samples are stamped late or early"
    delay: float = parameter(
        "s",
        0.01,
        estimate=Estimate(
            0.01, 5e-5, "two nodes on one host's clock; walk: its estimate of each, 3 ms in an hour"
        ),
    )

    def true_time(self, t: Array) -> Array:
        return t - self.delay


@dataclass(frozen=True)
class ClockSkew(Effect):
    """A sample taken at t is stamped t (1 + ppm 1e-6), both from the log's start."""

    name: ClassVar[str] = "clock_skew"
    meaning: ClassVar[str] = "the node's clock runs fast or slow"
    alike: ClassVar[Mapping[str, str]] = {
        "time_offset": "record longer: a skew grows with time",
    }
    ppm: float = parameter("1e-6", 100.0, within=5e5)

    def true_time(self, t: Array) -> Array:
        return t / (1.0 + 1e-6 * self.ppm)


@dataclass(frozen=True)
class SampleRepeat(Effect):
    """With this probability a sample is sent with the values of the one before."""

    name: ClassVar[str] = "sample_repeat"
    shows: ClassVar[Shows] = "scatter"
    meaning: ClassVar[str] = "stale samples are sent again"
    alike: ClassVar[Mapping[str, str]] = {
        "outliers": "look for samples that are equal to the one before: only repeats have them",
    }
    probability: float = parameter("1", 0.01, positive=True, within=1.0)

    def repeat(self, chain: Chain, rng: np.random.Generator) -> None:
        fresh = rng.random(len(chain.t)) >= self.probability
        fresh[:1] = True
        source = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
        chain.gyro, chain.accel = chain.gyro[:, source], chain.accel[:, source]


@dataclass(frozen=True)
class Outliers(Effect):
    """With this probability a reading has a further error, of so many times the noise."""

    name: ClassVar[str] = "outliers"
    shows: ClassVar[Shows] = "scatter"
    meaning: ClassVar[str] = "single readings are wild"
    probability: float = parameter("1", 0.01, positive=True, within=1.0)
    sigma: float = parameter("noise", 10.0, positive=True)

    def spread(self, noise: Noise) -> tuple[float, float]:
        share = self.probability * self.sigma**2
        return share * noise.gyro**2, share * noise.accel**2

    def scatter(self, chain: Chain, noise: Noise, rng: np.random.Generator) -> None:
        for reading, one in ((chain.gyro, noise.gyro), (chain.accel, noise.accel)):
            hit = rng.random(reading.shape) < self.probability
            reading += hit * self.sigma * one * rng.standard_normal(reading.shape)
