"""Between which values a noise term lies: where the profile of the likelihood falls by so much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from hubodo.sensors.allan.likelihood import Likelihood, Maximum, N, R, Terms, slope_sigma

BOTH_SIDES = 3.841
"""Rise of -2 ln likelihood at the ends of a 95 % interval, chi-square of one degree of freedom."""
_WIDTH = 2.0 * 1.95996
_MOST_STEPS = 12
_MOST_SIGMAS = 3.0
# Points of a few degrees of freedom have heavier tails than their cube roots' Gaussian: with this limits of
# 95 % cover 93 % of records, as tests/accuracy/allan_truth.py prints.
_TAILS = 1.35


@dataclass(frozen=True)
class Interval:
    """A term's 95 % interval, in its own unit (not squared); the ramp's with its sign."""

    low: float
    high: float

    @property
    def sigma(self) -> float:
        """What ± 1 sigma a Gaussian with an interval as wide has."""
        return (self.high - self.low) / _WIDTH


def interval(likelihood: Likelihood, best: Maximum, term: int) -> Interval:
    """95 % interval of a term that is in the fit, the others at their best for each value of it."""
    low, high = (_edge(likelihood, best, term, side, BOTH_SIDES) for side in (-1, 1))
    return Interval(low, high) if term == R else Interval(float(np.exp(0.5 * low)), float(np.exp(0.5 * high)))


def limit(likelihood: Likelihood, best: Maximum, term: int, missed: float, claimed: float) -> float:
    """Upper limit, 95 %, of a term that is in the fit but not claimed; of a ramp's size.

    missed: by how much -2 ln likelihood rises without the term; claimed: from what rise on it would be
    claimed.
    """
    rise = _rise(float(np.sqrt(max(missed, 0.0))), float(np.sqrt(claimed)))
    if term == R:
        return max(abs(_edge(likelihood, best, R, side, rise)) for side in (-1, 1))
    return float(np.exp(0.5 * _edge(likelihood, best, term, 1, rise)))


def _rise(found: float, claimed: float) -> float:
    """Rise of -2 ln likelihood at the limit of a term found at so many sigma, and claimed from so many on.

    Limits are given only where nothing was claimed: of all records of which that is true, one in twenty may
    have a term beyond its limit. With truth r sigma above what was found, ndtr(-r) = 0.05
    ndtr(claimed - found - r).
    """

    def excess(r: float) -> float:
        return float(ndtr(-r) - 0.05 * ndtr(claimed - found - r))

    few = excess(_MOST_SIGMAS) > 0.0
    return (_TAILS * (_MOST_SIGMAS if few else float(brentq(excess, 1.0, _MOST_SIGMAS)))) ** 2


def _edge(likelihood: Likelihood, best: Maximum, term: int, side: int, rise: float) -> float:
    """Where -2 ln likelihood has risen by so much on one side of its minimum, in x of the term."""
    last = best.x
    if term == R:
        middle, reach = float(best.x[R]), float(slope_sigma(Terms.of(best.x).theta, likelihood.duration))
    else:
        # Below this a term no longer shows at any point.
        bottom = float(likelihood.guess([term])[term]) - 10.0
        middle, reach = max(float(best.x[term]), bottom), 0.01 if term == N else 0.2
    known: dict[float, float] = {0.0: -np.sqrt(rise)}

    def excess(reach: float) -> float:
        """Of the root of the rise, which is nearly a straight line."""
        nonlocal last
        if reach not in known:
            found = likelihood.best(best.active, last, {term: middle + side * reach})
            last = found.x
            known[reach] = float(np.sqrt(max(found.cost - best.cost, 0.0)) - np.sqrt(rise))
        return known[reach]

    inner = 0.0
    for _ in range(_MOST_STEPS):
        if excess(reach) >= 0.0:
            return middle + side * float(brentq(excess, inner, reach, xtol=0.02 * reach))
        inner, ahead = reach, np.sqrt(rise) / max(float(excess(reach) + np.sqrt(rise)), 1e-3)
        reach *= float(np.clip(1.15 * ahead, 1.2, 4.0))
    return middle + side * reach
