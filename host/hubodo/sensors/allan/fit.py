"""Which of Q, N, B, K, R an Allan deviation shows, how large they are, and what the record cannot tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from hubodo.sensors.allan.covariance import TERMS, design
from hubodo.sensors.allan.deviation import AllanPoints
from hubodo.sensors.allan.interval import interval, limit
from hubodo.sensors.allan.likelihood import BAND, B, K, Likelihood, Maximum, N, Q, R, Terms, slope_sigma
from hubodo.sensors.allan.needed import needed_length

FloatArray = NDArray[np.float64]

# A term is claimed when leaving it out costs this much of -2 ln likelihood: 3.3 sigma, one false claim in a
# thousand.
_KEEP = 10.8
# Averaging times above a sixth of the record rest on fewer than about 4 degrees of freedom.
_PARTS = 6
# What comes by chance less often than this is the model's fault.
_BY_CHANCE, _AHEAD = 0.02, 3
_LOOK = 2.0
_LATE, _SHARPER, _RIPPLE = 4, 0.5, 0.05
_FEWEST, _MOST_LEFT_OUT = 7, 8
# A model error is taken on when it raises twice the log-likelihood by this much.
_CLEARLY = 6.6

_NO_SHORTEST = (
    "the shortest averaging times, in which it would show, follow the sensor's bandwidth or a vibration; "
    "a longer record does not help, a wider bandwidth would"
)
_REASONS = (
    "the shortest averaging times do not fall as 1/tau: quantisation is hidden under the white noise",
    "no averaging time at which white noise stands out from the other terms",
    "no flat floor stands out between the white noise and what rises after it",
    "the longest averaging times that the record allows do not rise as sqrt(tau)",
    "the slope over the whole record is no more than the other terms would wander",
)


@dataclass(frozen=True)
class NoiseTerm:
    """One of Q, N, B, K, R in SI; value None with the reason when the record cannot show it.

    low, high: 95 % interval, None when not shown. limit: the term is smaller than this with 95 % confidence
    (None when shown). needed: record length in s that would show a term as large as the limit at 3 sigma,
    None when shown or when no practical record would.
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
    """The most likely terms of an Allan deviation.

    terms: by name. theta: (5,) squares of Q, N, B, K, R, also of what is too faint to be claimed. band: what
    the sensor's bandwidth does to the variance of the white noise at the first averaging time fitted,
    relative; -0.2: it is a fifth smaller. factors: (P,) fitted. chi2, dof: of the fit. misfit: relative
    error of the model under which the residuals are most likely, mostly 0; all sigmas hold it.
    """

    terms: dict[str, NoiseTerm]
    theta: FloatArray
    band: float
    factors: NDArray[np.int64]
    chi2: float
    dof: int
    misfit: float
    dt: float

    def variance(self, tau: FloatArray) -> FloatArray:
        """(P,) fitted Allan variance at tau (s); the band does before the first tau what it does there."""
        first = float(self.factors[0]) * self.dt
        white = self.theta[N] / tau * self.band * np.minimum(first / tau, 1.0)
        made: FloatArray = design(tau) @ self.theta + white
        return made


def fit_noise(points: AllanPoints, slope: float, level: Callable[[], AllanPoints]) -> NoiseFit:
    """Fit sigma^2(tau) = 3 Q^2/tau^2 + N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3 + R^2 tau^2/2, all terms at once.

    The most likely terms given the full covariance of the points under those terms (after Vaccaro and Zaki
    2012). Behind a low-pass, and after any filter of finite memory, white noise gives N^2/tau + c/tau^2 from
    the length of that memory on, c of either sign: it is fitted from the averaging time on from which that
    holds. A term is claimed where the fit misses it; one that is not still takes part in the sigmas of the
    others. points: octaves suffice, more only cost time. slope: of the record by least squares, unit/s: a
    further observation, of the ramp.
    """
    # Octaves alone: points closer together say nothing new and make the covariance singular.
    octave = points.factors & (points.factors - 1) == 0
    used = octave & (points.factors <= max(points.samples // _PARTS, 1))
    likelihood, best, chi2 = _believed(Likelihood.of(points, used, slope))
    if abs(slope) > _LOOK * slope_sigma(Terms.of(best.x).theta, likelihood.duration):
        flat = Likelihood.of(level(), used, slope, level=True).later(len(likelihood.tau) * -1)
        flat.misfit = likelihood.misfit
        ramp = flat.best((*best.active, R), best.x)
        if _missed(flat, ramp, R) > _KEEP:
            likelihood, best, chi2 = flat, ramp, flat.chi2(ramp.x)
    found = Terms.of(best.x)
    dof = len(likelihood.tau) - len(best.active) + (R in best.active)
    later = _an_octave_later(likelihood, best)
    terms = {}
    for term, name in enumerate(TERMS):
        if term == N or (term in best.active and _missed(likelihood, best, term) > _KEEP):
            value = float(abs(found.ramp)) if term == R else float(np.sqrt(found.theta[term]))
            ends = interval(likelihood, best, term)
            low, high = sorted((abs(ends.low), abs(ends.high)))
            # What the model is wrong by, it is wrong by in the same sense everywhere; and where it begins to
            # hold was a choice: half of what another one would change.
            wrong = 0.5 * likelihood.misfit * value
            chosen = 0.5 * (value - float(np.sqrt(later.theta[term]))) if later.theta[term] > 0.0 else 0.0
            sigma = float(np.linalg.norm([ends.sigma, wrong, chosen]))
            terms[name] = NoiseTerm(value, sigma, low=low, high=high)
        else:
            terms[name] = _not_shown(term, likelihood, best, points)
    return NoiseFit(
        terms, found.theta, float(found.band), likelihood.factors, chi2, dof, likelihood.misfit, points.dt
    )


def _an_octave_later(likelihood: Likelihood, best: Maximum) -> Terms:
    """The terms without the first averaging time; those of the whole where too few are left."""
    if len(likelihood.tau) <= _FEWEST or Q in best.active:
        return Terms.of(best.x)
    rest = likelihood.later(1)
    rest.misfit = likelihood.misfit
    return Terms.of(rest.best(best.active, best.x).x)


def _believed(whole: Likelihood) -> tuple[Likelihood, Maximum, float]:
    """The likelihood from where on the model holds, its maximum, and chi-square there.

    It holds where leaving out one, two or three points more makes the fit no better than chance would.
    """
    most = 1 + min(_MOST_LEFT_OUT, max(0, len(whole.tau) - _FEWEST))
    trials: list[tuple[Likelihood, Maximum, float]] = []

    def trial(start: int) -> tuple[Likelihood, Maximum, float]:
        while len(trials) <= start:
            likelihood = whole.later(len(trials))
            best = _all_terms(likelihood)
            trials.append((likelihood, best, likelihood.chi2(best.x)))
        return trials[start]

    for start in range(most):
        likelihood, best, chi2 = trial(start)
        further = range(1, min(_AHEAD, most - 1 - start) + 1)
        if all(chdtrc(k, max(chi2 - trial(start + k)[2], 0.0)) > _BY_CHANCE for k in further):
            break
    # What is just too small to be seen there is a quarter of that at twice the averaging time.
    if start + 1 < most and (start > 0 or _low_pass(likelihood, best)):
        likelihood, best, chi2 = trial(start + 1)
    if chdtrc(max(1, len(likelihood.tau) - len(best.active)), chi2) < _BY_CHANCE:
        likelihood, best = _with_misfit(likelihood, best)
    if start < _LATE:
        return likelihood, best, chi2
    # A ripple of some per cent must not cost averaging times that tell more than it spoils.
    least = _SHARPER * _white_sigma(likelihood, best)
    for early, theirs, chi2_there in trials[:start]:
        judged = _with_misfit(early, theirs)
        if 0.0 < judged[0].misfit < _RIPPLE and _white_sigma(*judged) < least:
            least, (likelihood, best), chi2 = _white_sigma(*judged), judged, chi2_there
    return likelihood, best, chi2


def _with_misfit(likelihood: Likelihood, best: Maximum) -> tuple[Likelihood, Maximum]:
    """The same with the relative model error under which the residuals are most likely."""
    likelihood.misfit = _misfit(likelihood, best)
    return likelihood, likelihood.best(best.active, best.x)


def _white_sigma(likelihood: Likelihood, best: Maximum) -> float:
    """Relative 1 sigma of N, what the model is wrong by included."""
    ends = interval(likelihood, best, N)
    return float(np.hypot(2.0 * ends.sigma / (ends.low + ends.high), 0.5 * likelihood.misfit))


def _all_terms(likelihood: Likelihood) -> Maximum:
    """The fit of every term that so many points can hold; a term that is not claimed may still be there.

    What goes as 1/tau^2 is quantisation only where it is seen from the first sample on and clearly adds to
    the white noise; else it is what a bandwidth does, of either sign.
    """
    slow = [K, B][: max(0, len(likelihood.tau) - 3)]
    best = likelihood.best((N, *slow, BAND) if len(likelihood.tau) > 2 else (N,))
    if likelihood.factors[0] == 1 and best.x[BAND] > 0.0:
        start = best.x.copy()
        start[Q] = np.log(np.expm1(best.x[BAND]) * likelihood.tau[0] / 3.0) + best.x[N]
        stepped = likelihood.best((Q, N, *slow), start)
        if _missed(likelihood, stepped, Q) > _KEEP and stepped.cost < best.cost + _CLEARLY:
            best = stepped
    return best


def _missed(likelihood: Likelihood, best: Maximum, term: int) -> float:
    """How much of -2 ln likelihood it costs to do without a term."""
    return likelihood.best([k for k in best.active if k != term], best.x).cost - best.cost


def _low_pass(likelihood: Likelihood, best: Maximum) -> bool:
    """Whether the white noise is clearly less in the first averaging time than later ones tell."""
    return best.x[BAND] < 0.0 and _missed(likelihood, best, BAND) > _KEEP


def _misfit(likelihood: Likelihood, best: Maximum) -> float:
    """Relative model error under which the residuals are most likely; mostly 0."""
    costs = {0.0: best.cost}
    for size in np.geomspace(1e-3, 1.0, 31):
        likelihood.misfit = float(size)
        costs[float(size)] = likelihood.cost(best.x)
    likelihood.misfit = 0.0
    least = min(costs, key=lambda size: costs[size])
    return least if costs[least] < costs[0.0] - _CLEARLY else 0.0


def _not_shown(term: int, likelihood: Likelihood, best: Maximum, points: AllanPoints) -> NoiseTerm:
    if term == Q:
        if likelihood.factors[0] > 1 or _low_pass(likelihood, best):
            return NoiseTerm(None, None, _NO_SHORTEST)
        best = likelihood.best([Q, *(k for k in best.active if k != BAND)], best.x)
    elif term not in best.active:
        best = likelihood.best([*best.active, term], best.x)
    most = limit(likelihood, best, term, _missed(likelihood, best, term), _KEEP)
    needed = needed_length(term, most, Terms.of(best.x).theta, points, _PARTS)
    return NoiseTerm(None, None, _REASONS[term], most, needed)
