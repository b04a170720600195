"""Tempering: the factor by which correlated residuals exaggerate the information of a log."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from hubodo.arrays import Array
from hubodo.gap.linear.linearisation import invert_information
from hubodo.gap.refit.cross_validation import compute_level_scatter, sum_folds

# P-value (1 sigma, one-sided) above which excess scatter of the block scores is attributed to chance.
_CHANCE_SCATTER_P_VALUE = 0.16
# Scatter of the noise level between folds, relative to that of white noise, from which on the noise is that
# of a road: 5 to 30 on real drives, at most 3 in simulated ones, even with several effects missing. Least
# tempering of such noise: the scores of whole drives show 3.5 to 10, those of half a drive between 1 and 8.
_MIN_UNEVEN_RATIO, _MIN_UNEVEN_TEMPERING = 4.0, 3.5


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


def measure_tempering(
    blocks: Array, raw_squares: Array, count: int, samples: Array, is_whitened: bool = False
) -> tuple[float, float]:
    """Return the tempering of the first `count` coordinates, without a prior, and its lower bound.

    blocks: (B, P+1, P+1) gram matrices of free terms, given effects, nuisances and the residual
    samples: (B,) readings in each block
    is_whitened: True if the weights contain the correlation of the noise

    The lower bound is that of noise whose level is uneven, under white weights. The few blocks of a short
    drive may show no correlation, while the mean of such noise imitates effects as on a long one.
    """
    gram = blocks.sum(axis=0)
    covariance = invert_information(gram[:-1, :-1], raw_squares)
    step = covariance @ gram[:-1, -1]
    score = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ step
    robust_covariance = covariance @ (score.T @ score) @ covariance
    inside = np.s_[:count, :count]
    tempering = compute_tempering(robust_covariance[inside], covariance[inside], len(blocks))
    squares = blocks[:, -1, -1] - (blocks[:, :-1, -1] + score) @ step
    lower_bound = _MIN_UNEVEN_TEMPERING if not is_whitened and _is_uneven(squares, samples) else 1.0
    return max(tempering, lower_bound), lower_bound


def _is_uneven(squares: Array, samples: Array) -> bool:
    """Return True if the level of the noise differs between folds as on a road.

    squares, samples: (B,) deviance of each block and its readings
    """
    count = float(samples.sum())
    white_scatter = float(squares.sum()) * np.sqrt(2.0 / max(count, 1.0))
    scatter = compute_level_scatter(sum_folds(squares), sum_folds(samples))
    return bool(scatter > _MIN_UNEVEN_RATIO * white_scatter)
