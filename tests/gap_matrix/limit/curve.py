"""Detection probability over the logarithm of size: a probit curve and the next sizes to test."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import log_ndtr
from scipy.stats import norm

from gap_matrix.world import Array

# Sizes of the first stage, and the prior of middle and width of the curve, in ln size. A test of known power
# rises from 16 to 84 % within 0.5 at this rate of false alarms; no curve can be much steeper.
FIRST_LN_SIZES = (-0.1, 0.15, 0.4, 0.65, 0.9, 1.2)
_PRIOR_MIDDLE, _PRIOR_MIDDLE_SIGMA = 0.4, 0.8
_PRIOR_LN_WIDTH, _PRIOR_LN_WIDTH_SIGMA = np.log(0.25), 0.5
_MIDDLE_GRID, _WIDTH_GRID = np.linspace(-1.5, 3.5, 201), np.exp(np.linspace(np.log(0.05), np.log(2.0), 60))
_NEXT_SIZES_IN_WIDTHS = (-1.2, -0.5, 0.0, 0.4, 0.9, 1.5)


@dataclass(frozen=True)
class DetectionCurve:
    """A probit curve: detection probability Φ((x - middle) / width) at ln size x.

    weight: (M, W) posterior probability of each middle and width of the grid
    """

    middle: float
    width: float
    weight: Array

    def detection_probability(self, x: Array) -> Array:
        """Return the detection probability at ln sizes x."""
        return np.asarray(norm.cdf((x - self.middle) / self.width))

    def ln_size_sigma(self, share: float) -> float:
        """Return the posterior 1 sigma of the ln size that is detected with probability `share`."""
        ln_sizes = _MIDDLE_GRID[:, None] + norm.ppf(share) * _WIDTH_GRID
        mean = float(np.sum(self.weight * ln_sizes))
        return float(np.sqrt(np.sum(self.weight * (ln_sizes - mean) ** 2)))


def fit_curve(x: Sequence[float], is_detected: Sequence[bool]) -> DetectionCurve:
    """Return the posterior mean curve of trials at ln sizes x, detected or not."""
    z = (np.asarray(x)[:, None, None] - _MIDDLE_GRID[:, None]) / _WIDTH_GRID
    detected = np.asarray(is_detected, bool)[:, None, None]
    log_weights = log_ndtr(np.where(detected, z, -z)).sum(axis=0)
    log_weights -= 0.5 * ((_MIDDLE_GRID[:, None] - _PRIOR_MIDDLE) / _PRIOR_MIDDLE_SIGMA) ** 2
    log_weights = log_weights - 0.5 * ((np.log(_WIDTH_GRID) - _PRIOR_LN_WIDTH) / _PRIOR_LN_WIDTH_SIGMA) ** 2
    weight = np.exp(log_weights - log_weights.max())
    weight /= weight.sum()
    middle = float(np.sum(weight * _MIDDLE_GRID[:, None]))
    return DetectionCurve(middle, float(np.exp(np.sum(weight * np.log(_WIDTH_GRID)))), weight)


def choose_next_sizes(x: Sequence[float], is_detected: Sequence[bool], count: int) -> list[float]:
    """Return the ln sizes of the next `count` trials, spread over the curve in random order."""
    if not len(x):
        sizes = np.interp(np.linspace(0, 5, count), range(6), FIRST_LN_SIZES)
    else:
        curve = fit_curve(x, is_detected)
        sizes = curve.middle + curve.width * np.interp(
            np.linspace(0, 5, count), range(6), _NEXT_SIZES_IN_WIDTHS
        )
    return [float(sizes[k]) for k in np.random.default_rng(count + len(x)).permutation(count)]


def solve_size(share: Callable[[float], float], target: float) -> float:
    """Return the size at which an increasing function of the size equals `target`."""
    return float(np.exp(brentq(lambda x: share(float(np.exp(x))) - target, np.log(1e-6), np.log(1e6))))
