"""Null distribution of the largest gain over all candidates, by a wild bootstrap (Wu 1986, Liu 1988).

Scores of blocks of time get random signs under the current model. Correlation among candidates and within a
block is preserved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, gammaln

from hubodo.arrays import Array

# Number of draws: a p-value of 1 %, where effects are decided, is known within half of itself.
BOOTSTRAP_DRAWS, BOOTSTRAP_SEED = 400, 1
# ln likelihood; beyond it the tail probability underflows.
_MAX_EXACT_GAIN = 300.0


@dataclass(frozen=True)
class ScoreTest:
    """The score test of one candidate.

    basis: (D, k) directions of its coordinates
    covariance: (k, k) of the coordinates, zero for unobservable ones
    """

    basis: Array
    covariance: Array

    @property
    def degrees_of_freedom(self) -> int:
        return int(np.count_nonzero(np.diag(self.covariance)))


@dataclass(frozen=True)
class NullDistribution:
    """Distribution of the largest gain over all candidates if nothing is missing.

    surprises: (BOOTSTRAP_DRAWS,) surprise of the best candidate of each draw, see `compute_surprise`,
        ascending; empty without candidates, and noise is then assumed independent
    """

    surprises: Array

    def p_value(self, gain: float, degrees_of_freedom: int) -> float:
        """Return the probability that the best of all candidates gains as much by chance.

        Beyond their median the surprises have an exponential tail (Gumbel 1958), which extrapolates beyond
        all draws.
        """
        observed = float(compute_surprise(np.array(gain), degrees_of_freedom))
        if not len(self.surprises):
            return float(np.exp(-observed))
        median = float(np.median(self.surprises))
        if observed <= median:
            return float(np.mean(self.surprises >= observed))
        mean_excess = float(np.mean(self.surprises[self.surprises > median] - median))
        return float(np.maximum(0.5 * np.exp((median - observed) / mean_excess), 1e-300))


def compute_surprise(gain: Array, degrees_of_freedom: int) -> Array:
    """Return -ln of the probability that independent noise gains as much ln likelihood.

    Twice the gain follows a chi-square distribution; far out, the first term of its incomplete gamma function
    (DLMF 8.11.2) is used.
    """
    half = 0.5 * max(degrees_of_freedom, 1)
    gain = np.asarray(gain, float)
    far = gain - (half - 1.0) * np.log(np.maximum(gain, 1.0)) + gammaln(half)
    near = -np.log(chdtrc(2.0 * half, 2.0 * np.clip(gain, 0.0, _MAX_EXACT_GAIN)))
    return np.asarray(np.where(gain < _MAX_EXACT_GAIN, near, far))


def draw_null_distribution(
    scores: Array, tests: Sequence[ScoreTest], draws: int = BOOTSTRAP_DRAWS, seed: int = BOOTSTRAP_SEED
) -> NullDistribution:
    """Draw the largest gain of all tests under random signs of blocks.

    scores: (B, D) score of each block along each direction, with all fitted directions projected out
    """
    tests = [test for test in tests if test.degrees_of_freedom]
    if not tests:
        return NullDistribution(np.empty(0))
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (draws, len(scores)))
    drawn = signs @ scores
    # Among tests with equally many coordinates, the largest gain is the most surprising.
    gains: dict[int, Array] = {}
    for test in tests:
        projected = drawn[:, : len(test.basis)] @ test.basis
        test_gains = 0.5 * np.einsum("ri,ij,rj->r", projected, test.covariance, projected)
        gains[test.degrees_of_freedom] = np.maximum(gains.get(test.degrees_of_freedom, 0.0), test_gains)
    best = np.max([compute_surprise(gain, freedom) for freedom, gain in gains.items()], axis=0)
    return NullDistribution(np.sort(np.maximum(best, 0.0)))
