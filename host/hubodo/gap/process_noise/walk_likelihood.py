"""Likelihood and smoother of a random walk observed in white noise.

The first value and the steps between values have a tridiagonal covariance. Solving with it is equivalent to a
Kalman filter and smoother (Kalman 1960; Rauch, Tung and Striebel 1965).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpttrf, dpttrs

from hubodo.arrays import Array

DIFFUSE_VARIANCE = 1e6
"""Variance of the start of a walk with a diffuse prior."""


def walk_log_likelihoods(
    observed: Array,
    variance: Array,
    steps: Array,
    intensities: Array,
    starts: Array,
    trends: Array | None = None,
) -> Array:
    """Return ln likelihood, (G,), up to a constant, of random walks given noisy observations.

    observed, variance: (K,) values and their noise variances
    steps: (K-1,) s between them
    intensities: (G,) unit² per second
    starts: (G,) variance about zero before the first value
    trends: (M, K) curves of unknown size that the observations contain; their sizes are integrated out
        under a flat prior (restricted likelihood, Patterson and Thompson 1971)
    """
    rows, log_determinants, products = _increments(observed, trends), [], []
    for intensity, start in zip(intensities.tolist(), starts.tolist(), strict=True):
        variances, solved = _solve_steps(rows.T, variance, steps, intensity, start)
        log_determinants.append(float(np.log(variances).sum()))
        products.append(rows @ solved)
    # One call for all intensities: the matrices of the trends are small.
    stacked = np.array(products)
    _, trend_determinants = np.linalg.slogdet(stacked[:, 1:, 1:])
    explained = np.sum(stacked[:, 1:, 0] * _trend_sizes(stacked), axis=1)
    return np.asarray(-0.5 * (stacked[:, 0, 0] - explained + np.array(log_determinants) + trend_determinants))


def smooth_walk(
    observed: Array,
    variance: Array,
    steps: Array,
    intensity: float,
    start: float = DIFFUSE_VARIANCE,
    trends: Array | None = None,
) -> Array:
    """Return the smoothed walk with its trends, (K,); parameters as in `walk_log_likelihoods`."""
    rows = _increments(observed, trends)
    _, solved = _solve_steps(rows.T, variance, steps, intensity, start)
    without_trends = solved[:, 0] - solved[:, 1:] @ _trend_sizes(rows @ solved)
    return observed + variance * np.diff(without_trends, append=0.0)


def _increments(observed: Array, trends: Array | None) -> Array:
    """Return the increments of the observations and of the trends, (1 + M, K), from zero before the first."""
    return np.diff(observed[None] if trends is None else np.vstack([observed, trends]), prepend=0.0)


def _trend_sizes(products: Array) -> Array:
    """Return the sizes of the trends, (..., M), by generalised least squares.

    products: (..., 1 + M, 1 + M), increments times their inverse covariance times increments
    """
    return np.asarray(np.linalg.solve(products[..., 1:, 1:], products[..., 1:, :1])[..., 0])


def _solve_steps(
    increments: Array, variance: Array, steps: Array, intensity: float, start: float
) -> tuple[Array, Array]:
    """Return the variances of the innovations, (K,), and the increments divided by their covariance.

    increments: (K,) or (K, M)
    """
    diagonal = variance + np.concatenate([[start], intensity * steps + variance[:-1]])
    variances, below, _ = dpttrf(diagonal, -variance[:-1])
    solved, _ = dpttrs(variances, below, increments)
    return variances, solved
