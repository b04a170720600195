"""Covariance of averages of a drifting gyro with the noise terms Q, N, B and K of IEEE 952.

The averages are over intervals of one continuous record. Rate random walk (K) is a Wiener process that
starts with the record. Flicker (B) is a sum of first-order Markov processes with logarithmically spaced
time constants; with the variance B² ln(r)/pi each, where r is the ratio of neighbouring time constants, it
has S(f) = B²/(2 pi f) between the shortest and the longest. Quantisation (Q) is white noise of the angle;
vibration without net rotation has the same effect on averages.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array

FLICKER_TIME_RATIO = 3.0
"""Ratio of neighbouring time constants; the deviation from 1/f is then below one per cent."""


@dataclass(frozen=True)
class DriftNoise:
    """Noise terms of a gyro after IEEE 952: n in rad/√s, b in rad/s, k in rad/s/√s, q in rad."""

    n: float
    b: float
    k: float
    q: float = 0.0

    def allan_deviation(self, tau: Array) -> Array:
        """Return the Allan deviation, rad/s, at averaging times tau, s."""
        slow_variance = 2 * np.log(2) / np.pi * self.b**2 + self.k**2 * tau / 3
        return np.asarray(np.sqrt(3 * self.q**2 / tau**2 + self.n**2 / tau + slow_variance))


def white_covariance(start: Array, end: Array) -> Array:
    """Return the (M, M) covariance of white noise with N = 1."""
    return np.diag(1 / (end - start))


def random_walk_covariance(start: Array, end: Array) -> Array:
    """Return the (M, M) covariance of rate random walk with K = 1: mean of min(u, v) over both intervals."""
    middle = (start + end) / 2 - start[0]
    covariance = np.minimum.outer(middle, middle)
    np.fill_diagonal(covariance, start - start[0] + (end - start) / 3)
    return np.asarray(covariance)


def flicker_covariance(start: Array, end: Array) -> Array:
    """Return the (M, M) covariance of flicker noise with B = 1."""
    length = end - start
    # Flicker with a time constant below a sixtieth of an interval contributes less than one per cent.
    shortest, longest = float(length.min()) / 60, 6 * float(end.max() - start.min())
    count = int(np.ceil(np.log(longest / shortest) / np.log(FLICKER_TIME_RATIO))) + 1
    time_constants = shortest * np.exp(np.linspace(0, np.log(longest / shortest), count))
    variance = np.log(time_constants[1] / time_constants[0]) / np.pi
    middle = (start + end) / 2
    distance = np.abs(np.subtract.outer(middle, middle))
    half_length = length / 2
    covariance = np.zeros((len(start), len(start)))
    for tau in time_constants:
        # Mean of exp(-|u - v|/tau) over two intervals at distance d: exp(-d/tau) sinh(a) sinh(b)/(a b),
        # with a and b the half lengths over tau. Computed in logarithms, because sinh overflows for
        # intervals of many tau.
        x = half_length / tau
        log_sinh = x + np.log(-np.expm1(-2 * x) / (2 * x))
        block = np.exp(np.minimum(log_sinh[:, None] + log_sinh[None, :] - distance / tau, 0.0))
        y = length / tau
        np.fill_diagonal(block, 2 * (y + np.expm1(-y)) / y**2)
        covariance += variance * block
    return covariance


def quantisation_covariance(start: Array, end: Array) -> Array:
    """Return the (M, M) covariance of quantisation with Q = 1; adjacent intervals share one angle error."""
    covariance = np.diag(2 / (end - start) ** 2)
    adjacent = np.flatnonzero(start[1:] - end[:-1] < 0.01 * (end - start)[1:])
    shared_error = -1 / ((end - start)[adjacent] * (end - start)[adjacent + 1])
    covariance[adjacent, adjacent + 1] = covariance[adjacent + 1, adjacent] = shared_error
    return np.asarray(covariance)


def drift_covariance(drift: DriftNoise, start: Array, end: Array) -> Array:
    """Return the (M, M) covariance of the averages, (rad/s)², relative to an unknown constant bias."""
    return np.asarray(
        drift.q**2 * quantisation_covariance(start, end)
        + drift.n**2 * white_covariance(start, end)
        + drift.b**2 * flicker_covariance(start, end)
        + drift.k**2 * random_walk_covariance(start, end)
    )
