"""Which of Q, N, B, K, R an Allan deviation shows, how large they are, and what the record cannot tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hubodo.sensors.allan.covariance import TERMS, covariance_tensor, design
from hubodo.sensors.allan.deviation import AllanPoints, averaging_factors
from hubodo.sensors.allan.gls import B, Gls, K, N, Q, R

FloatArray = NDArray[np.float64]

# A term stays when leaving it out costs this much chi-square: 0.5 % false alarms for a variance at its zero
# bound.
_KEEP = 6.63
_SIGMAS = 3.0
_LIMIT = 1.645
_DOUBLINGS = 12
# Averaging times above a sixth of the record rest on fewer than about 4 degrees of freedom: their chi-square
# is too skew for a least-squares fit.
_PARTS = 6
# Real sensors have a bandwidth and vibrate: their shortest averaging times follow none of the five terms,
# with an error bar of a tenth of a percent. They are left out while that brings the model error down clearly.
_GOOD_MISFIT = 0.05
_BETTER = 1.5
_FEWEST, _MOST_LEFT_OUT = 7, 8


_NO_SHORTEST = (
    "the shortest averaging times, in which it would show, follow the sensor's bandwidth or a vibration and "
    "were left out; a longer record does not help, a wider bandwidth would"
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

    limit: the term is smaller than this with 95 % confidence (None when shown). needed: record length in s
    that would show a term as large as the limit at 3 sigma, None when shown or when no practical record
    would.
    """

    value: float | None
    sigma: float | None
    reason: str = ""
    limit: float | None = None
    needed: float | None = None


@dataclass(frozen=True)
class NoiseFit:
    """A weighted fit of the terms to an Allan deviation.

    terms: by name. theta: (5,) squares of Q, N, B, K, R, zero where not shown. covariance: (5, 5) of theta.
    factors: (P,) fitted. chi2, dof: of the fit with the covariance of the points alone. misfit: relative
    error of the model under which the residuals are most likely, mostly 0; it, and what chi2 has too much,
    widen all sigmas.
    """

    terms: dict[str, NoiseTerm]
    theta: FloatArray
    covariance: FloatArray
    factors: NDArray[np.int64]
    chi2: float
    dof: int
    misfit: float

    def variance(self, tau: FloatArray) -> FloatArray:
        """(P,) fitted Allan variance at tau (s)."""
        made: FloatArray = design(tau) @ self.theta
        return made


def fit_noise(points: AllanPoints, slope: float) -> NoiseFit:
    """Fit sigma^2(tau) = 3 Q^2/tau^2 + N^2/tau + (2 ln2/pi) B^2 + K^2 tau/3 + R^2 tau^2/2, all terms at once.

    Generalised least squares in the squares of the terms, none negative, with the full covariance of the
    points under the fitted model itself (Vaccaro and Zaki 2012), iterated. Terms are then left out one by one
    as long as none of them is missed. points: octaves suffice, more only cost time. slope: of the record by
    least squares, unit/s: a ramp is only believed when the slope is 3 sigma beyond what the other terms would
    wander.
    """
    # Octaves alone: points closer together say nothing new and make the covariance singular.
    octave = points.factors & (points.factors - 1) == 0
    used = octave & (points.factors <= max(points.samples // _PARTS, 1))
    factors, tau = points.factors[used], points.tau[used]
    avar = points.adev[used] ** 2
    tensor = covariance_tensor(factors, points.samples, points.dt)
    # Gaps leave fewer pairs than the covariance of a complete record counts on.
    lost = (points.samples - 2 * factors + 1) / points.pairs[used]
    tensor *= np.sqrt(np.outer(lost, lost))[:, :, None, None]
    matrix = design(tau)
    duration = points.samples * points.dt

    def fitted(start: int) -> _Trial:
        part = slice(start, None)
        return _Trial.fit(matrix[part], avar[part], tensor[part, part], factors[part], slope, duration)

    start, trial = _believed(fitted, min(_MOST_LEFT_OUT, max(0, len(tau) - _FEWEST)))
    active = trial.active
    fit = trial.gls
    excess = fit.weigh(fit.theta).excess()
    while len(active) > 1:
        costs = [fit.cost_without(term) for term in active]
        least = int(np.argmin(costs))
        if costs[least] > _KEEP * excess:
            break
        active = [term for term in active if term != active[least]]
        fit = fit.again().solve(active)

    covariance = np.zeros((5, 5))
    covariance[np.ix_(active, active)] = fit.parameter_covariance(active)
    terms = {}
    for term, name in enumerate(TERMS):
        if term in active:
            value = float(np.sqrt(fit.theta[term]))
            terms[name] = NoiseTerm(value, float(np.sqrt(covariance[term, term])) / (2 * value))
        else:
            terms[name] = _not_shown(term, fit, active, slope, points)
    dof = len(tau) - start - len(active)
    return NoiseFit(terms, fit.theta, covariance, factors[start:], trial.chi2, dof, fit.relative_misfit)


@dataclass(frozen=True)
class _Trial:
    """All terms fitted to the points from one averaging time on.

    chi2: how badly they fit without a model error.
    """

    gls: Gls
    active: list[int]
    chi2: float

    @classmethod
    def fit(
        cls,
        matrix: FloatArray,
        avar: FloatArray,
        tensor: FloatArray,
        factors: NDArray[np.int64],
        slope: float,
        duration: float,
    ) -> _Trial:
        # Quantisation lives in the shortest averaging times alone: without them it is not looked for.
        active = [Q, N, B, K] if factors[0] == 1 else [N, B, K]
        active = active[: max(1, len(avar) - 1)]
        gls = Gls(matrix, avar, tensor, factors).solve(active)
        if len(avar) > len(active) + 1:
            # Judged by the fit that has a ramp: without one, a walk would take its place and explain any
            # slope.
            ramp = Gls(matrix, avar, tensor, factors).solve([*active, R])
            if abs(slope) > _SIGMAS * slope_sigma(ramp.theta, duration):
                gls, active = ramp, [*active, R]
        chi2 = gls.weigh(gls.theta).chi2(gls.theta)
        gls.relative_misfit = gls.misfit()
        return cls(gls.solve(active), active, chi2)


def _believed(fitted: Callable[[int], _Trial], most: int) -> tuple[int, _Trial]:
    """From which point on, `most` at the latest, the fit is believed, and that fit."""
    whole = fitted(0)
    if whole.gls.relative_misfit <= _GOOD_MISFIT:
        return 0, whole
    later = [fitted(start) for start in range(1, most + 1)]
    tolerable = max(_GOOD_MISFIT, _BETTER * min(trial.gls.relative_misfit for trial in (whole, *later)))
    if whole.gls.relative_misfit > tolerable:
        for start, trial in enumerate(later, 1):
            # Only where the points left out are to blame themselves, by seven sigma each.
            if trial.gls.relative_misfit <= tolerable and whole.chi2 - trial.chi2 > 50.0 * start:
                return start, trial
    return 0, whole


def slope_sigma(theta: FloatArray, duration: float) -> float:
    """1 sigma of the least-squares slope of a record, unit/s; theta: (5,) squares of the terms; duration: s.

    The integral of each noise density over the response of the slope to a frequency.
    """
    t = duration
    return float(
        np.sqrt(
            72.0 * theta[Q] / t**4
            + 12.0 * theta[N] / t**3
            + 9.0 / np.pi * theta[B] / t**2
            + 1.2 * theta[K] / t
        )
    )


def _not_shown(term: int, fit: Gls, active: list[int], slope: float, points: AllanPoints) -> NoiseTerm:
    duration = points.samples * points.dt
    if term == Q and fit.starts_late:
        return NoiseTerm(None, None, _NO_SHORTEST)
    if term == R:
        limit = abs(slope) + _LIMIT * slope_sigma(fit.theta, duration)
    else:
        square, spread = fit.estimate_with(term, active)
        limit = float(np.sqrt(square + _LIMIT * spread))
    needed = _needed(term, limit, fit.theta, points)
    return NoiseTerm(None, None, _REASONS[term], limit, needed)


def _needed(term: int, size: float, theta: FloatArray, points: AllanPoints) -> float | None:
    """Record length in s, to a factor of 2, in which a term of this size would stand at 3 sigma.

    None beyond 4096 times this record.
    """
    shortest, longest = 1, _DOUBLINGS + 1
    while shortest < longest:
        doublings = (shortest + longest) // 2
        if _seen(term, size, theta, points.samples << doublings, points.dt):
            longest = doublings
        else:
            shortest = doublings + 1
    return None if shortest > _DOUBLINGS else float((points.samples << shortest) * points.dt)


def _seen(term: int, size: float, theta: FloatArray, samples: int, dt: float) -> bool:
    if term == R:
        return size > _SIGMAS * slope_sigma(theta, samples * dt)
    present = theta.copy()
    present[term] = size**2
    active = [int(k) for k in np.flatnonzero(present)]
    factors, matrix, tensor = _octaves(samples, dt)
    fit = Gls(matrix, matrix @ present, tensor, factors).weigh(present)
    place = active.index(term)
    return size**2 > _SIGMAS * float(np.sqrt(fit.parameter_covariance(active)[place, place]))


@lru_cache(maxsize=2 * _DOUBLINGS)
def _octaves(samples: int, dt: float) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Factors, design and covariance tensor of a record of this length.

    Kept, as all terms ask for the same lengths.
    """
    factors = averaging_factors(samples)
    factors = factors[factors <= samples // _PARTS]
    return factors, design(np.asarray(factors * dt, np.float64)), covariance_tensor(factors, samples, dt)
