"""Delete-a-group jackknife: how surely an effect is there, by its estimates from parts of a log.

Where residuals are correlated, one tempering factor for all candidates is a poor guess: the same vibration
hides a gyro's bias and hardly affects a lever arm. The scatter of an effect's own estimates shows what the
residuals of this log do to it, whatever their spectrum (Efron 1982, Künsch 1989).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, ndtr, stdtrit

from hubodo.arrays import Array
from hubodo.gap.refit.cross_validation import FoldGrams
from hubodo.gap.refit.prior import CoordinatePrior

# Largest number of groups; a group has at least one block of windows, which is longer than most correlation.
MAX_GROUPS = 32
# Probability that a Gaussian error is below one sigma; its sign counts.
_ONE_SIGMA_PROBABILITY = float(ndtr(1.0))
# Smallest probability that a double represents in full.
_MIN_PROBABILITY = 1e-300


@dataclass(frozen=True)
class JackknifeTest:
    """Test of an estimate by its scatter over groups of the log.

    surprise: -ln of the probability of the estimate if the effect is absent; 0 if too few groups show it
    agreement_sigmas: the best determined coordinate, in units of that scatter
    """

    surprise: float = 0.0
    agreement_sigmas: float = 0.0


def apply_jackknife(
    groups: FoldGrams, prior: CoordinatePrior, value: Array, places: NDArray[np.intp]
) -> JackknifeTest:
    """Test an estimate against the absence of the effect.

    groups: gram matrices of consecutive groups of blocks
    prior: prior of all coordinates
    value: (k,) coordinates of the effect at the fit, zero if it is absent
    places: (k,) their indices

    With n groups and the jackknife covariance V of k estimates,
    (n - k) / (k (n - 1)) value' V⁻¹ value follows an F distribution with k and n - k degrees of freedom
    (Hotelling's T²); n counts the groups that determine the estimates, such as stops of a wheel. All
    coordinates are tested together, and each one alone, as often only one is not zero. The larger surprise
    counts, less ln k for the choice (Bonferroni).
    """
    step, deviations = _leave_out_groups(groups, prior, places)
    is_observed = np.any(deviations != 0.0, axis=0)
    estimate, deviations = (value + step)[is_observed], deviations[:, is_observed]
    if not len(estimate):
        return JackknifeTest()
    squares, places = deviations.T @ deviations, places[is_observed]
    information = groups.grams[:, places[:, None], places]
    alone = [
        _test(estimate[k], squares[np.ix_(k, k)], information[:, k[:, None], k])
        for k in np.arange(len(estimate))[:, None]
    ]
    surprise = max(_test(estimate, squares, information), max(alone) - math.log(len(alone)))
    return JackknifeTest(surprise, float(np.max(np.abs(estimate) / np.sqrt(np.diag(squares)))))


def compute_jackknife_covariance(
    groups: FoldGrams, prior: CoordinatePrior, places: NDArray[np.intp]
) -> Array:
    """Return the covariance, (k, k), of the coordinates at k places.

    Unlike the scatter of scores, it is not too small where few groups determine an estimate: without one of
    them, the others say something else (Efron 1982; MacKinnon and White 1985, HC3). As the scatter of few
    groups is uncertain itself, a sigma is that of Student's distribution: it covers 68 % of the errors.
    """
    count, (_, deviations) = len(groups.grams), _leave_out_groups(groups, prior, places)
    information = groups.grams[:, places, places]
    dof = [max(_count_informative(one[:, None, None]) - 1.0, 1.0) for one in information.T]
    factor = stdtrit(np.array(dof), _ONE_SIGMA_PROBABILITY)
    return np.asarray((count - 1) / count * deviations.T @ deviations * np.outer(factor, factor))


def _leave_out_groups(
    groups: FoldGrams, prior: CoordinatePrior, places: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Return the step of the fit to all groups, (k,), and its changes without each group, (G, k)."""
    total = groups.grams.sum(axis=0)
    step = groups.fit_step(total, prior)[places]
    return step, np.array([groups.fit_step(total - gram, prior)[places] for gram in groups.grams]) - step


def _test(estimate: Array, squares: Array, information: Array) -> float:
    """Return -ln of the p-value of k estimates, (k,).

    squares: (k, k) sum of the products of the deviations by leaving out each group
    information: (G, k, k) of each group
    """
    size, count = len(estimate), _count_informative(information)
    if count <= size + 1:
        return 0.0
    quadratic = count / (count - 1) * float(estimate @ np.linalg.pinv(squares, hermitian=True) @ estimate)
    statistic = (count - size) / (size * (count - 1)) * quadratic
    return -math.log(max(float(fdtrc(size, count - size, statistic)), _MIN_PROBABILITY))


def _count_informative(information: Array) -> float:
    """Return the effective number of groups, at most G, that determine an estimate.

    A group counts by its leverage: of an effect that shows at three stops alone, three groups count.
    """
    inverse = np.linalg.pinv(information.sum(axis=0), hermitian=True)
    leverage = np.einsum("ij,gji->g", inverse, information)
    return float(leverage.sum() ** 2 / max(np.sum(leverage**2), 1e-300))
