"""Delete-a-group jackknife: how surely an effect is there, by its estimates from parts of a log.

Where residuals are correlated, one tempering factor for all candidates is a poor guess: the same vibration
hides a gyro's bias and hardly affects a lever arm. The scatter of an effect's own estimates shows what the
residuals of this log do to it, whatever their spectrum (Efron 1982, Künsch 1989).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from hubodo.arrays import Array
from hubodo.gap.refit.cross_validation import FoldGrams
from hubodo.gap.refit.prior import CoordinatePrior

# Largest number of groups; a group has at least one block of windows, which is longer than most correlation.
MAX_GROUPS = 32
# Smallest probability that a double represents in full.
_MIN_PROBABILITY = 1e-300


def compute_jackknife_surprise(
    groups: FoldGrams, prior: CoordinatePrior, value: Array, places: NDArray[np.intp]
) -> float:
    """Return -ln of the probability of an estimate if the effect is absent.

    groups: gram matrices of consecutive groups of blocks
    prior: prior of all coordinates
    value: (k,) coordinates of the effect at the fit, zero if it is absent
    places: (k,) their indices

    With n groups and the jackknife covariance V of k estimates,
    (n - k) / (k (n - 1)) value' V⁻¹ value follows an F distribution with k and n - k degrees of freedom
    (Hotelling's T²). All coordinates are tested together, and each one alone, as often only one is not zero.
    The larger surprise counts, less ln k for the choice (Bonferroni).
    """
    total, count = groups.grams.sum(axis=0), len(groups.grams)
    step = groups.fit_step(total, prior)[places]
    deviations = np.array([groups.fit_step(total - gram, prior)[places] for gram in groups.grams]) - step
    is_observed = np.any(deviations != 0.0, axis=0)
    estimate, deviations = (value + step)[is_observed], deviations[:, is_observed]
    if not len(estimate):
        return 0.0
    covariance = (count - 1) / count * deviations.T @ deviations
    alone = [_test(estimate[[k]], covariance[k : k + 1, k : k + 1], count) for k in range(len(estimate))]
    return max(_test(estimate, covariance, count), max(alone) - math.log(len(alone)))


def _test(estimate: Array, covariance: Array, count: int) -> float:
    """Return -ln of the p-value of k estimates, (k,), with covariance, (k, k), from `count` groups."""
    size = len(estimate)
    if count <= size + 1:
        return 0.0
    quadratic = float(estimate @ np.linalg.pinv(covariance, hermitian=True) @ estimate)
    statistic = (count - size) / (size * (count - 1)) * quadratic
    return -math.log(max(float(fdtrc(size, count - size, statistic)), _MIN_PROBABILITY))
