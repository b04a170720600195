"""What the data say for one effect against its absence: gain less Occam's factor."""

from __future__ import annotations

from itertools import combinations
from math import comb, log

import numpy as np
from scipy.special import logsumexp

from hubodo.arrays import Array

# Prior widths in units of the usual sizes of the effects.
WIDE = 1.0


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
    terms: list[float] = []
    for size in range(1, k + 1):
        share = -log(k) - log(comb(k, size))
        members = np.array(list(combinations(range(k), size)))
        inner, along = information[members[:, :, None], members[:, None, :]], slope[members][:, :, None]
        there = np.linalg.solve(inner + np.eye(size) * 1e-9, along)
        lost = np.maximum(whole - 0.5 * (along.transpose(0, 2, 1) @ there)[:, 0, 0], 0.0)
        occam = 0.5 * np.linalg.slogdet(np.eye(size) + WIDE**2 * inner)[1]
        far = np.log(1.0 + np.sum((there[:, :, 0] / WIDE) ** 2, axis=1))
        terms += (gain - lost - occam - 0.5 * (size + 1) * far + share).tolist()
    return float(logsumexp(terms))
