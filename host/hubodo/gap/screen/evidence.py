"""What the data say for one effect against its absence: gain less Occam's factor."""

from __future__ import annotations

from itertools import combinations
from math import comb, log

import numpy as np
from scipy.special import logsumexp

from hubodo.arrays import Array

# Prior widths in units of the usual sizes of the effects, each as likely as the others: how large an effect
# is on this vehicle nobody knows, within decades. With one width alone, of two names that fit alike the one
# that happens to be nearer to its usual size would win, and a faint one would pay for all that it is not.
WIDTHS = (1.0, 0.3, 0.1, 0.03, 0.01)


def log_evidence(gain: float, value: Array, information: Array) -> float:
    """ln of the Bayes factor of an effect against its absence.

    gain: in log-likelihood, all its coordinates fitted. value: (k,) how far they went, in scales.
    information: (k, k) about them, everything else fitted; coordinates without any say nothing either way.
    Occam's factor of a prior of one width, ½ ln det(1 + w² A) (MacKay 1992), with the tails of a Cauchy
    distribution, so that an effect much larger than usual costs little; WIDTHS share the prior, and so do, as
    nobody knows which coordinates are at work, all their subsets, equally by size.
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
    terms: list[float] = []
    for size in range(1, k + 1):
        share = -log(k) - log(comb(k, size))
        members = np.array(list(combinations(range(k), size)))
        inner, along = information[members[:, :, None], members[:, None, :]], slope[members][:, :, None]
        there = np.linalg.solve(inner + np.eye(size) * 1e-9, along)
        lost = np.maximum(whole - 0.5 * (along.transpose(0, 2, 1) @ there)[:, 0, 0], 0.0)
        length = np.sum(there[:, :, 0] ** 2, axis=1)
        for width in WIDTHS:
            occam = 0.5 * np.linalg.slogdet(np.eye(size) + width**2 * inner)[1]
            far = 0.5 * (size + 1) * np.log1p(length / width**2)
            terms += (gain - lost - occam - far + share).tolist()
    return float(logsumexp(terms)) - log(len(WIDTHS))
