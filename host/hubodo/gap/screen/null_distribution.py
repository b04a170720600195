"""What gains the best of all candidates would have by chance: signs of the scores of blocks drawn anew.

A wild bootstrap (Wu 1986, Liu 1988) under the model as it stands: each block of time keeps its scores, with
what they have in common among candidates and within the block, and loses their sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, gammaln

from hubodo.arrays import Array

# Draws: the hundredth part of them, where a name is decided, is known to half of itself.
DRAWS, SEED = 400, 1
# ln likelihood beyond which the chance of it is too small for floating point.
_FAR = 300.0


@dataclass(frozen=True)
class ScoreTest:
    """One candidate's score test.

    basis: (D, k) directions of its coordinates. covariance: (k, k) of them, zero for what is not seen.
    """

    basis: Array
    covariance: Array

    @property
    def freedom(self) -> int:
        return int(np.count_nonzero(np.diag(self.covariance)))


@dataclass(frozen=True)
class NullDistribution:
    """What chance brings.

    surprises: (DRAWS,) ascending, of the best of all candidates; see `surprise`. Empty where there was no
    candidate: then noise is taken for independent.
    """

    surprises: Array

    def p_value(self, gain: float, freedom: int) -> float:
        """How often the best of all candidates gains as much by chance.

        Beyond their median such surprises fall off exponentially (Gumbel 1958), so far beyond all draws, too.
        """
        own = float(surprise(np.array(gain), freedom))
        if not len(self.surprises):
            return float(np.exp(-own))
        middle = float(np.median(self.surprises))
        if own <= middle:
            return float(np.mean(self.surprises >= own))
        beyond = float(np.mean(self.surprises[self.surprises > middle] - middle))
        return float(np.maximum(0.5 * np.exp((middle - own) / beyond), 1e-300))


def surprise(gain: Array, freedom: int) -> Array:
    """-ln of the chance that independent noise gains so much of ln likelihood with so many coordinates.

    Of a chi square of twice the gain; far out, the first term of its incomplete gamma function (DLMF 8.11.2).
    """
    half = 0.5 * max(freedom, 1)
    gain = np.asarray(gain, float)
    far = gain - (half - 1.0) * np.log(np.maximum(gain, 1.0)) + gammaln(half)
    near = -np.log(chdtrc(2.0 * half, 2.0 * np.clip(gain, 0.0, _FAR)))
    return np.asarray(np.where(gain < _FAR, near, far))


def null_distribution(
    scores: Array, tests: Sequence[ScoreTest], draws: int = DRAWS, seed: int = SEED
) -> NullDistribution:
    """What the best of all tests gains when the signs of blocks are drawn anew.

    scores: (B, D) of each block along each direction, everything fitted already taken out.
    """
    tests = [test for test in tests if test.freedom]
    if not tests:
        return NullDistribution(np.empty(0))
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (draws, len(scores)))
    drawn = signs @ scores
    # Of tests with as many coordinates, the one with the most gain is the most surprising.
    gains: dict[int, Array] = {}
    for test in tests:
        along = drawn[:, : len(test.basis)] @ test.basis
        own = 0.5 * np.einsum("ri,ij,rj->r", along, test.covariance, along)
        gains[test.freedom] = np.maximum(gains.get(test.freedom, 0.0), own)
    best = np.max([surprise(gain, freedom) for freedom, gain in gains.items()], axis=0)
    return NullDistribution(np.sort(np.maximum(best, 0.0)))
