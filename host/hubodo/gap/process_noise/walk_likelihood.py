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
    observed: Array, variance: Array, steps: Array, intensities: Array, starts: Array
) -> Array:
    """Return ln likelihood, (G,), up to a constant, of random walks given noisy observations.

    observed, variance: (K,) values and their noise variances
    steps: (K-1,) s between them
    intensities: (G,) unit² per second
    starts: (G,) variance about zero before the first value
    """
    likelihoods, increments = [], np.diff(observed, prepend=0.0)
    for intensity, start in zip(intensities.tolist(), starts.tolist(), strict=True):
        variances, solved = _solve_steps(increments, variance, steps, intensity, start)
        likelihoods.append(-0.5 * (float(increments @ solved) + float(np.log(variances).sum())))
    return np.array(likelihoods)


def smooth_walk(
    observed: Array, variance: Array, steps: Array, intensity: float, start: float = DIFFUSE_VARIANCE
) -> Array:
    """Return the smoothed walk, (K,); parameters as in `walk_log_likelihoods`."""
    _, solved = _solve_steps(np.diff(observed, prepend=0.0), variance, steps, intensity, start)
    return observed + variance * np.diff(solved, append=0.0)


def _solve_steps(
    increments: Array, variance: Array, steps: Array, intensity: float, start: float
) -> tuple[Array, Array]:
    """Return the variances of the innovations, (K,), and the increments divided by their covariance, (K,)."""
    diagonal = variance + np.concatenate([[start], intensity * steps + variance[:-1]])
    variances, below, _ = dpttrf(diagonal, -variance[:-1])
    solved, _ = dpttrs(variances, below, increments)
    return variances, solved
