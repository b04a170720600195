"""What the data say for one effect against its absence: gain less Occam's factor."""

from __future__ import annotations

from itertools import combinations
from math import comb, log

import numpy as np
from scipy.special import logsumexp

from hubodo.arrays import Array

# Of a coordinate that only shows where a fit ends.
USUAL = 1.0
# Prior widths in units of the usual sizes of the effects, each as likely as the others up to the usual size,
# larger ones as much less likely as they are larger: how large an effect is on this vehicle nobody knows,
# within decades. With one width alone, of two names that fit alike the one that happens to be nearer to its
# usual size would win, and a faint one would pay for all that it is not; so it is where the widths end: the
# narrowest lies below the smallest size that a minute of driving shows, a thousandth of what is usual.
WIDTHS = np.geomspace(1e-4, 100.0, 13)
_CHANCES = np.minimum(1.0, 1.0 / WIDTHS) / np.minimum(1.0, 1.0 / WIDTHS).sum()


def log_evidence(gain: float, value: Array, information: Array) -> float:
    """ln of the Bayes factor of an effect against its absence.

    gain: in log-likelihood, all its coordinates fitted. value: (k,) how far they went, in scales.
    information: (k, k) about them, everything else fitted; coordinates without any say nothing either way.
    The marginal likelihood under a Gaussian prior of each of WIDTHS, with Occam's factor ½ ln det(1 + w² A)
    (MacKay 1992); which coordinates are at work is not known, so all their subsets share the prior, equally
    by size.
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
        spread, axes = np.linalg.eigh(inner)
        spread = np.maximum(spread, 0.0)[:, None]
        along = (axes.transpose(0, 2, 1) @ along).transpose(0, 2, 1)
        # (subsets, widths): what a prior of that width leaves of the gain, and what it costs.
        kept = 0.5 * np.sum(along**2 / (spread + WIDTHS[:, None] ** -2.0), axis=2)
        occam = 0.5 * np.sum(np.log1p(WIDTHS[:, None] ** 2 * spread), axis=2)
        terms += (gain - np.maximum(whole - kept, 0.0) - occam + np.log(_CHANCES) + share).ravel().tolist()
    return float(logsumexp(terms))
