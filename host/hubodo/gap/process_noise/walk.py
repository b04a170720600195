"""A random walk seen in noise: how likely it is, and where it was as all that was seen shows it.

What is seen first, and then the steps from one to the next, have a covariance of three diagonals: solved at
once, that is what a Kalman filter and a smoother do (Kalman 1960; Rauch, Tung and Striebel 1965).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpttrf, dpttrs

from hubodo.arrays import Array

UNKNOWN = 1e6
"""Variance about zero where nothing is known."""


def scores(seen: Array, variance: Array, steps: Array, intensities: Array, starts: Array) -> Array:
    """(G,) ln likelihood, up to a constant, of walks behind values seen, (K,), with these variances, (K,).

    steps: (K-1,) s between them. intensities: (G,) unit² per second. starts: (G,) variance about zero before
    the first.
    """
    made, stepped = [], np.diff(seen, prepend=0.0)
    for intensity, start in zip(intensities.tolist(), starts.tolist(), strict=True):
        power, solved = _solved(stepped, variance, steps, intensity, start)
        made.append(-0.5 * (float(stepped @ solved) + float(np.log(power).sum())))
    return np.array(made)


def smoothed(seen: Array, variance: Array, steps: Array, intensity: float, start: float = UNKNOWN) -> Array:
    """(K,) the walk as all values show it; see `scores`."""
    _, solved = _solved(np.diff(seen, prepend=0.0), variance, steps, intensity, start)
    return seen + variance * np.diff(solved, append=0.0)


def _solved(
    stepped: Array, variance: Array, steps: Array, intensity: float, start: float
) -> tuple[Array, Array]:
    """(K,) variances of the innovations, and the steps seen, (K,), over their covariance."""
    diagonal = variance + np.concatenate([[start], intensity * steps + variance[:-1]])
    power, below, _ = dpttrf(diagonal, -variance[:-1])
    solved, _ = dpttrs(power, below, stepped)
    return power, solved
