"""Confidence intervals and upper limits of noise terms from the profile likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from hubodo.sensors.allan.likelihood import Likelihood, LikelihoodMaximum, N, NoiseParameters, R, slope_sigma

CHI2_95_ONE_DOF = 3.841
"""Increase of -2 ln likelihood at the ends of a 95 % interval: chi-square quantile, 1 degree of freedom."""
_INTERVAL_95_SIGMAS = 2.0 * 1.95996
_MAX_BRACKETING_STEPS = 12
_MAX_LIMIT_SIGMA = 3.0
# Allan variances with few degrees of freedom have heavier tails than the Gaussian assumed for their cube
# roots. With this factor on the limit's sigma, 95 % limits cover 93 % of records;
# tests/accuracy/allan_truth.py prints that share.
_TAIL_FACTOR = 1.35


@dataclass(frozen=True)
class ConfidenceInterval:
    """The 95 % interval of a noise term in its own unit (not squared); that of the ramp is signed."""

    low: float
    high: float

    @property
    def sigma(self) -> float:
        """Return the standard deviation of a Gaussian whose 95 % interval has the same width."""
        return (self.high - self.low) / _INTERVAL_95_SIGMAS


def profile_interval(likelihood: Likelihood, maximum: LikelihoodMaximum, term: int) -> ConfidenceInterval:
    """Return the 95 % profile-likelihood interval of a term in the fit, maximised over the other terms."""
    low, high = (_profile_bound(likelihood, maximum, term, side, CHI2_95_ONE_DOF) for side in (-1, 1))
    return (
        ConfidenceInterval(low, high)
        if term == R
        else ConfidenceInterval(float(np.exp(0.5 * low)), float(np.exp(0.5 * high)))
    )


def upper_limit(
    likelihood: Likelihood, maximum: LikelihoodMaximum, term: int, cost_without: float, claim_cost: float
) -> float:
    """Return the 95 % upper limit of a term in the fit that is not significant; for a ramp, of its magnitude.

    cost_without: increase of -2 ln likelihood without the term. claim_cost: increase from which on a term
    counts as significant.
    """
    rise = _limit_cost_rise(float(np.sqrt(max(cost_without, 0.0))), float(np.sqrt(claim_cost)))
    if term == R:
        return max(abs(_profile_bound(likelihood, maximum, R, side, rise)) for side in (-1, 1))
    return float(np.exp(0.5 * _profile_bound(likelihood, maximum, term, 1, rise)))


def _limit_cost_rise(observed_sigma: float, claim_sigma: float) -> float:
    """Return the increase of -2 ln likelihood at the upper limit of a term observed at `observed_sigma`.

    Limits are given only for terms below `claim_sigma`, so the 95 % refer to the records in which the term
    is not significant: with the true value r sigma above the observed one, ndtr(-r) = 0.05
    ndtr(claim_sigma - observed_sigma - r).
    """

    def excess(r: float) -> float:
        return float(ndtr(-r) - 0.05 * ndtr(claim_sigma - observed_sigma - r))

    out_of_range = excess(_MAX_LIMIT_SIGMA) > 0.0
    return (
        _TAIL_FACTOR * (_MAX_LIMIT_SIGMA if out_of_range else float(brentq(excess, 1.0, _MAX_LIMIT_SIGMA)))
    ) ** 2


def _profile_bound(
    likelihood: Likelihood, maximum: LikelihoodMaximum, term: int, side: int, rise: float
) -> float:
    """Return the coordinate x of a term where -2 ln likelihood exceeds its minimum by `rise`.

    side: 1 for the bound above the minimum, -1 for the one below.
    """
    last = maximum.x
    if term == R:
        centre, reach = (
            float(maximum.x[R]),
            float(slope_sigma(NoiseParameters.from_vector(maximum.x).theta, likelihood.duration)),
        )
    else:
        # Below this value the term does not affect any point.
        bottom = float(likelihood.initial_guess([term])[term]) - 10.0
        centre, reach = max(float(maximum.x[term]), bottom), 0.01 if term == N else 0.2
    excess_at: dict[float, float] = {0.0: -np.sqrt(rise)}

    def excess(reach: float) -> float:
        """Return sqrt(increase of cost) - sqrt(rise), nearly linear in the distance `reach`."""
        nonlocal last
        if reach not in excess_at:
            constrained = likelihood.maximise(maximum.active, last, {term: centre + side * reach})
            last = constrained.x
            excess_at[reach] = float(np.sqrt(max(constrained.cost - maximum.cost, 0.0)) - np.sqrt(rise))
        return excess_at[reach]

    inner = 0.0
    for _ in range(_MAX_BRACKETING_STEPS):
        if excess(reach) >= 0.0:
            return centre + side * float(brentq(excess, inner, reach, xtol=0.02 * reach))
        inner, growth = reach, np.sqrt(rise) / max(float(excess(reach) + np.sqrt(rise)), 1e-3)
        reach *= float(np.clip(1.15 * growth, 1.2, 4.0))
    return centre + side * reach
