"""Maximum-likelihood fit of the noise terms Q, N, B, K, R to an Allan deviation, with limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from hubodo.arrays import Array
from hubodo.sensors.allan.covariance import TERMS, design_matrix
from hubodo.sensors.allan.deviation import AllanPoints
from hubodo.sensors.allan.interval import CHI2_95_ONE_DOF, profile_interval, upper_limit
from hubodo.sensors.allan.likelihood import (
    BAND,
    B,
    K,
    Likelihood,
    LikelihoodMaximum,
    N,
    NoiseParameters,
    Q,
    R,
    slope_sigma,
)
from hubodo.sensors.allan.markov import MarkovNoise, fit_markov
from hubodo.sensors.allan.record_length import required_record_length

# A term is significant if -2 ln likelihood increases by this much without it: 3.3 sigma, one false term in
# a thousand.
_CLAIM_COST = 10.8
# Averaging times above a sixth of the record have fewer than about 4 degrees of freedom.
_MIN_RECORD_PER_TAU = 6
# A misfit with a lower p-value is attributed to the model; it is tested over this many octaves ahead.
_MIN_P_VALUE, _LOOKAHEAD_OCTAVES = 0.02, 3
_RAMP_SEARCH_SIGMA = 2.0
_LATE_START_OCTAVE, _EARLIER_START_SIGMA_RATIO, _MAX_RIPPLE = 4, 0.5, 0.05
_MIN_OCTAVES, _MAX_SKIPPED_OCTAVES = 7, 8
# Significance of a model error: chi-square quantile 99 % for one degree of freedom.
_CHI2_99_ONE_DOF = 6.6

_BAND_LIMITED_REASON = (
    "the shortest averaging times, where quantisation would be visible, follow the sensor's bandwidth "
    "or a vibration; a longer record does not help, a wider bandwidth would"
)
_NOT_SHOWN_REASONS = (
    "the shortest averaging times do not fall as 1/tau: quantisation is hidden under the white noise",
    "white noise does not dominate at any averaging time",
    "no flat floor is visible between the white noise and the rise at longer averaging times",
    "the deviation does not rise as sqrt(tau) up to the longest averaging time that the record allows",
    "the slope over the whole record is no larger than the other terms explain",
)


@dataclass(frozen=True)
class NoiseTerm:
    """One noise term of an Allan deviation: Q, N, B, K or R, in SI units.

    Attributes
    ----------
    value : float or None
        Estimate; None if the record does not show the term.
    sigma : float or None
        Standard deviation (1 sigma) of `value`.
    reason : str
        Reason why the term is not shown, empty otherwise.
    limit : float or None
        Upper limit (95 %) of a term that is not shown.
    needed : float or None
        Record length in s that would show a term as large as `limit` at 3 sigma; None if the term is
        shown, or if no practical record would show it.
    low, high : float or None
        95 % confidence interval of a term that is shown.

    References
    ----------
    IEEE Std 952-1997, annex C: names and Allan variances of the terms.
    """

    value: float | None
    sigma: float | None
    reason: str = ""
    limit: float | None = None
    needed: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class NoiseFit:
    """The maximum-likelihood noise terms of an Allan deviation.

    Attributes:
        terms: noise terms by name.
        theta: (5,) squares of Q, N, B, K, R, including terms that are not significant.
        band: relative change, by the sensor's bandwidth, of the white noise variance at the first
            averaging time fitted; -0.2 means that it is smaller by a fifth.
        factors: (P,) averaging factors used in the fit.
        chi2, dof: chi-square of the fit and its degrees of freedom.
        misfit: most likely relative model error, usually 0; all sigmas include it.
        markov: correlated noise beside the terms, if the points demand it.
        dt: sample interval, s.
    """

    terms: dict[str, NoiseTerm]
    theta: Array
    band: float
    factors: NDArray[np.int64]
    chi2: float
    dof: int
    misfit: float
    dt: float
    markov: MarkovNoise | None = None

    def variance(self, tau: Array) -> Array:
        """Return the (P,) fitted Allan variance at tau (s).

        Below the first averaging time fitted, `band` acts as it does there.
        """
        first = float(self.factors[0]) * self.dt
        white = self.theta[N] / tau * self.band * np.minimum(first / tau, 1.0)
        variance: Array = design_matrix(tau) @ self.theta + white
        return variance if self.markov is None else variance + self.markov.variance(tau)


def fit_noise(points: AllanPoints, slope: float, detrended_points: Callable[[], AllanPoints]) -> NoiseFit:
    """Fit sigma^2(tau) = 3 Q^2/tau^2 + N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3 + R^2 tau^2/2, all terms jointly.

    Maximises the likelihood with the full covariance of the points under the fitted terms (after Vaccaro
    and Zaki 2012). Behind a low-pass, or any filter of finite memory, the variance of white noise is
    N^2/tau + c/tau^2 for averaging times longer than that memory, with c of either sign; shorter averaging
    times are excluded. Terms that are not significant still contribute to the sigmas of the others.
    points: octaves suffice. slope: least-squares slope of the record, unit/s, a further observation of the
    ramp. detrended_points: returns the points of the record minus that slope.
    """
    # Only octaves are fitted: denser points add no information and make the covariance singular.
    octave = points.factors & (points.factors - 1) == 0
    used = octave & (points.factors <= max(points.samples // _MIN_RECORD_PER_TAU, 1))
    full = Likelihood.from_points(points, used, slope)
    likelihood, maximum, chi2 = _select_first_octave(full)
    markov = fit_markov(full) if likelihood.misfit > 0.0 or likelihood.factors[0] > 1 else None
    if markov is not None:
        likelihood, maximum = markov.likelihood, markov.maximum
        chi2 = likelihood.chi2(maximum.x)
        if chdtrc(max(1, len(likelihood.tau) - len(maximum.active) - 2), chi2) < _MIN_P_VALUE:
            likelihood, maximum = _refit_with_misfit(likelihood, maximum)
    if abs(slope) > _RAMP_SEARCH_SIGMA * slope_sigma(
        NoiseParameters.from_vector(maximum.x).theta, likelihood.duration
    ):
        detrended = Likelihood.from_points(detrended_points(), used, slope, detrended=True).from_octave(
            len(likelihood.tau) * -1
        )
        detrended.misfit, detrended.correlated = likelihood.misfit, likelihood.correlated
        with_ramp = detrended.maximise((*maximum.active, R), maximum.x)
        if _cost_without(detrended, with_ramp, R) > _CLAIM_COST:
            likelihood, maximum, chi2 = detrended, with_ramp, detrended.chi2(with_ramp.x)
    parameters = NoiseParameters.from_vector(maximum.x)
    dof = len(likelihood.tau) - len(maximum.active) + (R in maximum.active)
    later = _refit_one_octave_later(likelihood, maximum)
    terms = {}
    for term, name in enumerate(TERMS):
        if term == N or (term in maximum.active and _cost_without(likelihood, maximum, term) > _CLAIM_COST):
            value = float(abs(parameters.ramp)) if term == R else float(np.sqrt(parameters.theta[term]))
            bounds = profile_interval(likelihood, maximum, term)
            low, high = sorted((abs(bounds.low), abs(bounds.high)))
            # The model error has the same sign at all points, so it does not average out. The first
            # averaging time fitted is a choice; half of the change by choosing the next octave is counted
            # as its sigma.
            misfit_sigma = 0.5 * likelihood.misfit * value
            start_sigma = (
                0.5 * (value - float(np.sqrt(later.theta[term]))) if later.theta[term] > 0.0 else 0.0
            )
            markov_sigma = markov.spread if markov is not None and term == N else 0.0
            sigma = float(np.linalg.norm([bounds.sigma, misfit_sigma, start_sigma, markov_sigma]))
            terms[name] = NoiseTerm(value, sigma, low=low, high=high)
            if sigma > value:
                limit = value + CHI2_95_ONE_DOF**0.5 * sigma
                terms[name] = NoiseTerm(None, None, _NOT_SHOWN_REASONS[term], limit)
        else:
            terms[name] = _hidden_term(term, likelihood, maximum, points)
    return NoiseFit(
        terms,
        parameters.theta,
        float(parameters.band),
        likelihood.factors,
        chi2,
        dof,
        likelihood.misfit,
        points.dt,
        None if markov is None else markov.noise,
    )


def _refit_one_octave_later(likelihood: Likelihood, maximum: LikelihoodMaximum) -> NoiseParameters:
    """Return the terms fitted without the shortest averaging time.

    Returns the original terms if too few points remain.
    """
    if len(likelihood.tau) <= _MIN_OCTAVES or Q in maximum.active:
        return NoiseParameters.from_vector(maximum.x)
    remainder = likelihood.from_octave(1)
    remainder.misfit = likelihood.misfit
    return NoiseParameters.from_vector(remainder.maximise(maximum.active, maximum.x).x)


def _select_first_octave(full: Likelihood) -> tuple[Likelihood, LikelihoodMaximum, float]:
    """Return the likelihood from the first octave at which the model fits, its maximum and chi-square.

    The model fits if skipping one, two or three more points does not improve the fit significantly.
    """
    max_start = 1 + min(_MAX_SKIPPED_OCTAVES, max(0, len(full.tau) - _MIN_OCTAVES))
    trials: list[tuple[Likelihood, LikelihoodMaximum, float]] = []

    def trial(start: int) -> tuple[Likelihood, LikelihoodMaximum, float]:
        while len(trials) <= start:
            likelihood = full.from_octave(len(trials))
            maximum = _fit_all_terms(likelihood)
            trials.append((likelihood, maximum, likelihood.chi2(maximum.x)))
        return trials[start]

    for start in range(max_start):
        likelihood, best, chi2 = trial(start)
        further = range(1, min(_LOOKAHEAD_OCTAVES, max_start - 1 - start) + 1)
        if all(chdtrc(k, max(chi2 - trial(start + k)[2], 0.0)) > _MIN_P_VALUE for k in further):
            break
    # A remaining bandwidth effect just below detection is four times smaller one octave later.
    if start + 1 < max_start and (start > 0 or _is_low_passed(likelihood, best)):
        likelihood, best, chi2 = trial(start + 1)
    if chdtrc(max(1, len(likelihood.tau) - len(best.active)), chi2) < _MIN_P_VALUE:
        likelihood, best = _refit_with_misfit(likelihood, best)
    if start < _LATE_START_OCTAVE:
        return likelihood, best, chi2
    # A ripple of a few per cent must not exclude short averaging times that reduce the sigma of N by more
    # than the ripple adds.
    smallest_sigma = _EARLIER_START_SIGMA_RATIO * _relative_white_noise_sigma(likelihood, best)
    for earlier, earlier_maximum, earlier_chi2 in trials[:start]:
        refitted = _refit_with_misfit(earlier, earlier_maximum)
        if 0.0 < refitted[0].misfit < _MAX_RIPPLE and _relative_white_noise_sigma(*refitted) < smallest_sigma:
            smallest_sigma, (likelihood, best), chi2 = (
                _relative_white_noise_sigma(*refitted),
                refitted,
                earlier_chi2,
            )
    return likelihood, best, chi2


def _refit_with_misfit(
    likelihood: Likelihood, maximum: LikelihoodMaximum
) -> tuple[Likelihood, LikelihoodMaximum]:
    """Return the likelihood, with the most likely relative model error, and its maximum."""
    likelihood.misfit = _estimate_misfit(likelihood, maximum)
    return likelihood, likelihood.maximise(maximum.active, maximum.x)


def _relative_white_noise_sigma(likelihood: Likelihood, maximum: LikelihoodMaximum) -> float:
    """Return the relative standard deviation of N, including the model error."""
    bounds = profile_interval(likelihood, maximum, N)
    return float(np.hypot(2.0 * bounds.sigma / (bounds.low + bounds.high), 0.5 * likelihood.misfit))


def _fit_all_terms(likelihood: Likelihood) -> LikelihoodMaximum:
    """Fit as many terms as the number of points allows.

    A component proportional to 1/tau^2 is attributed to quantisation only if it is present from the first
    sample on and significantly adds to the white noise; otherwise it is attributed to the bandwidth, with
    either sign.
    """
    slow = [K, B][: max(0, len(likelihood.tau) - 3)]
    best = likelihood.maximise((N, *slow, BAND) if len(likelihood.tau) > 2 else (N,))
    if likelihood.factors[0] == 1 and best.x[BAND] > 0.0:
        start = best.x.copy()
        start[Q] = np.log(np.expm1(best.x[BAND]) * likelihood.tau[0] / 3.0) + best.x[N]
        stepped = likelihood.maximise((Q, N, *slow), start)
        if (
            _cost_without(likelihood, stepped, Q) > _CLAIM_COST
            and stepped.cost < best.cost + _CHI2_99_ONE_DOF
        ):
            best = stepped
    return best


def _cost_without(likelihood: Likelihood, maximum: LikelihoodMaximum, term: int) -> float:
    """Return the increase of -2 ln likelihood when a term is removed."""
    return likelihood.maximise([k for k in maximum.active if k != term], maximum.x).cost - maximum.cost


def _is_low_passed(likelihood: Likelihood, maximum: LikelihoodMaximum) -> bool:
    """Return True if the white noise at the first averaging time is significantly lower than later."""
    return maximum.x[BAND] < 0.0 and _cost_without(likelihood, maximum, BAND) > _CLAIM_COST


def _estimate_misfit(likelihood: Likelihood, maximum: LikelihoodMaximum) -> float:
    """Return the most likely relative model error; 0 unless it is significant."""
    costs = {0.0: maximum.cost}
    for size in np.geomspace(1e-3, 1.0, 31):
        likelihood.misfit = float(size)
        costs[float(size)] = likelihood.cost(maximum.x)
    likelihood.misfit = 0.0
    best_size = min(costs, key=lambda size: costs[size])
    return best_size if costs[best_size] < costs[0.0] - _CHI2_99_ONE_DOF else 0.0


def _hidden_term(
    term: int, likelihood: Likelihood, maximum: LikelihoodMaximum, points: AllanPoints
) -> NoiseTerm:
    """Return a term that is not significant, with reason, upper limit and record length needed."""
    if term == Q:
        if likelihood.factors[0] > 1 or _is_low_passed(likelihood, maximum):
            return NoiseTerm(None, None, _BAND_LIMITED_REASON)
        maximum = likelihood.maximise([Q, *(k for k in maximum.active if k != BAND)], maximum.x)
    elif term not in maximum.active:
        maximum = likelihood.maximise([*maximum.active, term], maximum.x)
    upper_bound = upper_limit(
        likelihood, maximum, term, _cost_without(likelihood, maximum, term), _CLAIM_COST
    )
    record_needed = required_record_length(
        term, upper_bound, NoiseParameters.from_vector(maximum.x).theta, points, _MIN_RECORD_PER_TAU
    )
    return NoiseTerm(None, None, _NOT_SHOWN_REASONS[term], upper_bound, record_needed)
