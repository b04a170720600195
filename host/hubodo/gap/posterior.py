"""How sure a name is: a posterior over the candidates, nothing, and something that is not listed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from math import comb, log

import numpy as np
from scipy.special import logsumexp

from hubodo.arrays import Array

# Prior widths in units of the usual sizes of the effects.
WIDE = 1.0
# Prior: as likely as not that nothing is missing. What is missing is mostly in the list; a term of a library
# that does no better than an effect with a name is that effect.
NOTHING, UNLISTED = log(0.5), log(1e-6)
_LISTED = log(0.5)


def log_evidence(gain: float, value: Array, information: Array) -> float:
    """ln of the Bayes factor of an effect against its absence.

    gain: in log-likelihood, all its coordinates fitted. value: (k,) how far they went, in scales.
    information: (k, k) about them, everything else fitted; coordinates without any say nothing either way.
    Occam's factor of a prior of one scale, ½ ln det(1 + A) (MacKay 1992), with the tails of a Cauchy
    distribution, so that an effect much larger than usual costs little; which coordinates are at work is not
    known, so all their subsets share the prior, equally by size.
    """
    seen = np.flatnonzero(np.diag(information) > 0.0)
    value, information = value[seen], information[np.ix_(seen, seen)]
    k = len(value)
    if not k:
        return -np.inf
    if gain < 2.0:
        # Nothing to share out: the sum below could only be a little under nothing.
        return -0.5 * k
    slope = information @ value
    whole = 0.5 * float(value @ slope)
    terms = []
    for size in range(1, k + 1):
        share = -log(k) - log(comb(k, size))
        for members in combinations(range(k), size):
            kept = list(members)
            inner = information[np.ix_(kept, kept)]
            there = np.linalg.solve(inner + np.eye(size) * 1e-9, slope[kept])
            lost = max(whole - 0.5 * float(slope[kept] @ there), 0.0)
            occam = 0.5 * float(np.linalg.slogdet(np.eye(size) + WIDE**2 * inner)[1])
            far = log(1.0 + float(np.sum((there / WIDE) ** 2)))
            terms.append(gain - lost - occam - 0.5 * (size + 1) * far + share)
    return float(logsumexp(terms))


def priors(names: Sequence[str], kinds: int) -> Array:
    """(len(names),) ln prior of candidates: every effect alike, its scopes and seeds share."""
    return np.array([_LISTED - log(kinds) - log(names.count(name)) for name in names])


def posterior(scores: Mapping[str, float]) -> dict[str, float]:
    """Probabilities from ln posteriors that are not normalised."""
    values = np.array(list(scores.values()))
    return dict(zip(scores, np.exp(values - logsumexp(values)).tolist(), strict=True))
