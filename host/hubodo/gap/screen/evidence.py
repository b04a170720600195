"""Evidence of an effect against its absence: gain in likelihood minus the Occam factor."""

from __future__ import annotations

from itertools import combinations
from math import comb, log

import numpy as np
from scipy.special import logsumexp

from hubodo.arrays import Array

# Prior width, in scales, of a coordinate that is observable only at the end of a fit.
USUAL_SCALE = 1.0
# Prior widths in units of the usual size of an effect, whose true size is unknown within decades: equally
# likely up to the usual size, inversely proportional to the width beyond it. With a single width, of two
# effects that fit equally well the one nearer to its usual size would win, and a faint effect would be
# penalised. The narrowest is below the smallest size visible in a minute of driving, 1/1000 of the usual one.
PRIOR_WIDTHS = np.geomspace(1e-4, 100.0, 13)
_WIDTH_PRIORS = np.minimum(1.0, 1.0 / PRIOR_WIDTHS) / np.minimum(1.0, 1.0 / PRIOR_WIDTHS).sum()


def compute_log_evidence(gain: float, value: Array, information: Array) -> float:
    """Return ln of the Bayes factor of an effect against its absence.

    gain: gain of ln likelihood, with all coordinates of the effect fitted
    value: (k,) fitted coordinates in scales
    information: (k, k) about them, everything else fitted; unobservable coordinates do not count

    The marginal likelihood under Gaussian priors of all PRIOR_WIDTHS w, with Occam factor ½ ln det(1 + w² A),
    A: information (MacKay 1992). As the coordinates at work are unknown, all their subsets share the prior,
    equally by size.
    """
    observed = np.flatnonzero(np.diag(information) > 0.0)
    value, information = value[observed], information[np.ix_(observed, observed)]
    k = len(value)
    if not k:
        return -np.inf
    if gain < 2.0:
        # Too little gain: the sum below could only be slightly negative.
        return -0.5 * k
    slope = information @ value
    quadratic_gain = 0.5 * float(value @ slope)
    terms: list[float] = []
    for size in range(1, k + 1):
        share = -log(k) - log(comb(k, size))
        members = np.array(list(combinations(range(k), size)))
        subset_information, projected = (
            information[members[:, :, None], members[:, None, :]],
            slope[members][:, :, None],
        )
        spread, axes = np.linalg.eigh(subset_information)
        spread = np.maximum(spread, 0.0)[:, None]
        projected = (axes.transpose(0, 2, 1) @ projected).transpose(0, 2, 1)
        # (subsets, widths) each: gain that remains under a prior of a width, and Occam factor.
        retained_gain = 0.5 * np.sum(projected**2 / (spread + PRIOR_WIDTHS[:, None] ** -2.0), axis=2)
        occam = 0.5 * np.sum(np.log1p(PRIOR_WIDTHS[:, None] ** 2 * spread), axis=2)
        terms += (
            (gain - np.maximum(quadratic_gain - retained_gain, 0.0) - occam + np.log(_WIDTH_PRIORS) + share)
            .ravel()
            .tolist()
        )
    return float(logsumexp(terms))
