"""Tempering: the factor by which correlated residuals exaggerate the information of a log."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from hubodo.arrays import Array
from hubodo.gap.linear.linearisation import invert_information

# P-value (1 sigma, one-sided) above which excess scatter of the block scores is attributed to chance.
_CHANCE_SCATTER_P_VALUE = 0.16


def compute_tempering(robust_covariance: Array, covariance: Array, n_blocks: int) -> float:
    """Return the mean ratio of the variance from the scatter of block scores to that of independent samples.

    robust_covariance, covariance: (K, K), of the same coordinates, all others fitted
    """
    observed = np.flatnonzero(np.diag(covariance))
    if not len(observed):
        return 1.0
    inside = np.ix_(observed, observed)
    ratio = np.trace(np.linalg.pinv(covariance[inside], hermitian=True) @ robust_covariance[inside]) / len(
        observed
    )
    degrees_of_freedom = len(observed) * max(n_blocks - 1.0, 1.0)
    return max(1.0, float(ratio * degrees_of_freedom / chdtri(degrees_of_freedom, _CHANCE_SCATTER_P_VALUE)))


def measure_tempering(blocks: Array, raw_squares: Array, count: int) -> float:
    """Return the tempering of free terms and given effects, `count` coordinates in total, without a prior."""
    gram = blocks.sum(axis=0)
    covariance = invert_information(gram[:-1, :-1], raw_squares)
    score = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ (covariance @ gram[:-1, -1])
    robust_covariance = covariance @ (score.T @ score) @ covariance
    inside = np.s_[:count, :count]
    return compute_tempering(robust_covariance[inside], covariance[inside], len(blocks))
