"""Covariance of averages of a drifting gyro: the noises Q, N, B and K of IEEE 952.

For averages over intervals i, j of one continuous record. Rate random walk W (K = 1) is a Wiener process
that starts with the record. Flicker F (B = 1) is the sum of first-order Markov processes with time constants
evenly spaced in their logarithm: variance B² ln(r)/pi each gives S(f) = B²/(2 pi f) between the shortest and
the longest. Quantisation Q is white noise of the angle; shaking that comes back to where it began adds to
averages in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array

RATIO = 3.0
"""Between time constants; the deviation from a straight 1/f is then below one per cent."""


@dataclass(frozen=True)
class Drift:
    """N in rad/sqrt(s), B in rad/s, K in rad/s/sqrt(s), Q in rad, names and definitions of IEEE 952."""

    n: float
    b: float
    k: float
    q: float = 0.0

    def allan_deviation(self, tau: Array) -> Array:
        """rad/s at averaging times tau, s."""
        slow = 2 * np.log(2) / np.pi * self.b**2 + self.k**2 * tau / 3
        return np.asarray(np.sqrt(3 * self.q**2 / tau**2 + self.n**2 / tau + slow))


def white(start: Array, end: Array) -> Array:
    """(M, M) for N = 1."""
    return np.diag(1 / (end - start))


def random_walk(start: Array, end: Array) -> Array:
    """(M, M) for K = 1: the mean of min(u, v) over both intervals, which do not overlap."""
    middle = (start + end) / 2 - start[0]
    made = np.minimum.outer(middle, middle)
    np.fill_diagonal(made, start - start[0] + (end - start) / 3)
    return np.asarray(made)


def flicker(start: Array, end: Array) -> Array:
    """(M, M) for B = 1."""
    length = end - start
    # Faster flicker than a sixtieth of an interval averages out of it to below one per cent.
    shortest, longest = float(length.min()) / 60, 6 * float(end.max() - start.min())
    count = int(np.ceil(np.log(longest / shortest) / np.log(RATIO))) + 1
    constants = shortest * np.exp(np.linspace(0, np.log(longest / shortest), count))
    share = np.log(constants[1] / constants[0]) / np.pi
    middle = (start + end) / 2
    apart = np.abs(np.subtract.outer(middle, middle))
    half = length / 2
    made = np.zeros((len(start), len(start)))
    for tau in constants:
        # Mean of exp(-|u - v|/tau) over two intervals: exp(-apart/tau) sinh(a) sinh(b)/(a b); in logarithms,
        # since sinh of an interval of many tau overflows where the exponential vanishes.
        x = half / tau
        rise = x + np.log(-np.expm1(-2 * x) / (2 * x))
        block = np.exp(np.minimum(rise[:, None] + rise[None, :] - apart / tau, 0.0))
        y = length / tau
        np.fill_diagonal(block, 2 * (y + np.expm1(-y)) / y**2)
        made += share * block
    return made


def quantization(start: Array, end: Array) -> Array:
    """(M, M) for Q = 1: the angle's error at the end less that at the start, which neighbours share."""
    made = np.diag(2 / (end - start) ** 2)
    touching = np.flatnonzero(start[1:] - end[:-1] < 0.01 * (end - start)[1:])
    shared = -1 / ((end - start)[touching] * (end - start)[touching + 1])
    made[touching, touching + 1] = made[touching + 1, touching] = shared
    return np.asarray(made)


def covariance(drift: Drift, start: Array, end: Array) -> Array:
    """(M, M) (rad/s)² of the averages, each relative to an unknown constant bias."""
    return np.asarray(
        drift.q**2 * quantization(start, end)
        + drift.n**2 * white(start, end)
        + drift.b**2 * flicker(start, end)
        + drift.k**2 * random_walk(start, end)
    )
