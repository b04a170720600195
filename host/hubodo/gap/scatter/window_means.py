"""Means of the gyro axes in windows of half a second, and their likelihood with a walk or slow noise."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION, window_boundaries
from hubodo.gap.process_noise.window_sums import winsorise

# Intensities of a walk, rad/s/√s, at which every axis is evaluated.
K_GRID = np.geomspace(1e-6, 3e-2, 28)
# Innovation, in sigma, beyond which a single window is a bump of the road.
_BUMP_SIGMA = 3.5


@dataclass(frozen=True)
class AxisMeans:
    """Window means of one gyro axis.

    mean: (K,) rad/s
    variance: (K,) of the noise of each mean
    steps: (K - 1,) s from one window to the next
    """

    mean: Array
    variance: Array
    steps: Array

    @cached_property
    def coarse_gain(self) -> Array:
        """Return the gain of ln likelihood over no walk for each k of `K_GRID`; scopes of nodes share it."""
        return self.gain(K_GRID)

    def gain(self, grid: Array) -> Array:
        """Return the gain of ln likelihood over no walk, (G,), for each k of a grid."""
        innovation, variance = _innovations(self, np.array([0.0, *grid**2]))
        likelihoods = -0.5 * (innovation**2 / variance + np.log(variance)).sum(axis=0)
        return np.asarray(likelihoods[1:] - likelihoods[0])

    def stationary_gain(self, sigmas: Array, correlation_time: float) -> Array:
        """Return the gain of ln likelihood over white noise, (S,), of slow noise that returns to zero.

        That is a Gauss-Markov process of constant variance; sigmas: (S,) rad/s.
        """
        variance = sigmas**2
        x, v, total = np.zeros_like(variance), variance, np.zeros_like(variance)
        for z, r, step in zip(
            self.mean.tolist(), self.variance.tolist(), [*self.steps.tolist(), 0.0], strict=True
        ):
            innovation, s, decay = z - x, v + r, np.exp(-step / correlation_time)
            total -= 0.5 * (innovation**2 / s + np.log(s / r) - z**2 / r)
            x = decay * (x + v / s * innovation)
            v = decay**2 * (v - v**2 / s) + (1.0 - decay**2) * variance
        return total

    def standardise(self, k: float) -> Array:
        """Return the innovations in units of their sigma, (K,)."""
        innovation, variance = _innovations(self, k**2)
        return np.asarray(innovation / np.sqrt(variance))

    def without_bumps(self, k: float) -> AxisMeans:
        """Return the means without windows that differ from the walk by many sigmas; itself without such."""
        regular = np.abs(self.standardise(k)) < _BUMP_SIGMA
        regular[0] = True
        if regular.all():
            return self
        times = np.concatenate([[0.0], np.cumsum(self.steps)])
        return AxisMeans(self.mean[regular], self.variance[regular], np.diff(times[regular]))


def _innovations(axis: AxisMeans, intensity: Array | float) -> tuple[Array, Array]:
    """Return the innovation of each window mean and its variance, (K, G) or (K,) each, for each k² or one.

    The mean of a walk over a window of length W differs from its value at the start by noise of variance k² W
    / 3, of which k² W / 2 is common with the step over the window. Treating means as points of the walk would
    underestimate k, by up to √(2/3) where the walk dominates.
    """
    x, v = 0.0 * intensity, intensity * WINDOW_DURATION
    innovations, variances = [], []
    for z, r, step in zip(
        axis.mean.tolist(), axis.variance.tolist(), [*axis.steps.tolist(), 0.0], strict=True
    ):
        innovation, variance = z - x, v + r + intensity * (WINDOW_DURATION / 3.0)
        innovations.append(innovation)
        variances.append(variance)
        shared_part = v + intensity * (0.5 * WINDOW_DURATION)
        x = x + shared_part / variance * innovation
        v = v + intensity * step - shared_part**2 / variance
    return np.array(innovations), np.array(variances)


def compute_window_means(residual: Residual) -> Iterator[AxisMeans]:
    """Yield the window means of each gyro axis."""
    edges = window_boundaries(residual.node.t)
    steps = np.diff(np.add.reduceat(residual.node.t, edges[:-1]) / np.diff(edges))
    for row in np.flatnonzero(residual.node.used[:3]):
        sigma = residual.noise.channel_sigma(row)
        winsorised = winsorise(residual.value[[row]] / sigma)[0] * sigma
        weight = (residual.noise.is_new & ~residual.node.is_saturated[row]) / sigma**2
        information = np.maximum(np.add.reduceat(weight, edges[:-1]), 1e-12)
        mean = np.add.reduceat(weight * winsorised, edges[:-1]) / information
        yield AxisMeans(mean, 1.0 / information + residual.input_variance[row], steps)
