"""Correlated noise of IEEE 952: a first-order Gauss-Markov process beside the five terms of a fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hubodo.arrays import Array
from hubodo.sensors.allan.gauss_newton import minimise
from hubodo.sensors.allan.likelihood import BAND, B, K, Likelihood, LikelihoodMaximum, N

_PROCESS_CLAIM_COST = 25.0
"""Decrease of -2 ln likelihood from which the process counts as shown; a search over times is included."""
_MIN_CORRELATION_SAMPLES = 8.0
"""Shorter correlation is that of the sensor's bandwidth."""
_MIN_RECORD_PER_TIME = 20.0
_TIMES = 16
_MIN_OCTAVES, _MAX_WHITE_RATIO = 8, 0.65
_MAX_LOG_SIZE_BELOW_POINTS, _MAX_LOG_SIZE_ABOVE_POINTS, _START_LOG_SIZE = 8.0, 0.7, -0.7
"""Logarithms of the size of the process relative to the largest that does not exceed any point."""


@dataclass(frozen=True)
class MarkovNoise:
    """A first-order Gauss-Markov process.

    Attributes:
        sigma: its standard deviation, in the unit of the record.
        time: correlation time, s.
    """

    sigma: float
    time: float

    def variance(self, tau: Array) -> Array:
        """Return its (P,) Allan variances at averaging times tau, s (IEEE 952-1997, C.1.5)."""
        return self.sigma**2 * _unit_variance(tau, self.time)

    def as_json(self) -> dict[str, Any]:
        """Return the process for the JSON result."""
        return {"sigma": self.sigma, "correlation_time": self.time}


@dataclass(frozen=True)
class MarkovFit:
    """The most probable process, and the maximum of the likelihood beside it.

    Attributes:
        noise: the process.
        likelihood, maximum: with the process as known.
        spread: standard deviation of N among the correlation times that the points allow.
    """

    noise: MarkovNoise
    likelihood: Likelihood
    maximum: LikelihoodMaximum
    spread: float


def _unit_variance(tau: Array, time: float) -> Array:
    ratio = tau / time
    bracket = 1.0 - (3.0 - 4.0 * np.exp(-ratio) + np.exp(-2.0 * ratio)) / (2.0 * ratio)
    return np.asarray(2.0 / ratio * bracket)


@dataclass(frozen=True)
class _Trial:
    """The most probable process of one correlation time, its -2 ln likelihood, and ln N² beside it."""

    noise: MarkovNoise
    cost: float
    log_square_of_n: float


def fit_markov(full: Likelihood) -> MarkovFit | None:
    """Return the fit from the first octave on with a process, or None if the points do not demand one.

    White noise must show in the first octaves, where it halves the variance: otherwise the correlation is
    that of the sensor's bandwidth.
    """
    if len(full.tau) < _MIN_OCTAVES or np.any(full.avar[1:3] > _MAX_WHITE_RATIO * full.avar[:2]):
        return None
    active = (N, K, B, BAND)
    plain = full.maximise(active)
    times = _correlation_times(full)
    if not len(times):
        return None
    trials = [_at_time(full, active, plain, float(time)) for time in times]
    at = int(np.argmin([trial.cost for trial in trials]))
    around = np.log([times[max(at - 1, 0)], times[min(at + 1, len(times) - 1)]])
    refined = minimize_scalar(
        lambda log_time: _at_time(full, active, plain, float(np.exp(log_time))).cost,
        bounds=around,
        method="bounded",
        options={"xatol": 0.02},
    ).x
    trials.append(_at_time(full, active, plain, float(np.exp(refined))))
    costs = np.array([trial.cost for trial in trials])
    best = trials[int(np.argmin(costs))].noise
    likelihood = replace(full, correlated=best.variance(full.tau))
    maximum = likelihood.maximise(active, plain.x)
    if plain.cost - maximum.cost < _PROCESS_CLAIM_COST:
        return None
    weights = np.exp(-0.5 * (costs - costs.min()))
    values = np.array([np.exp(0.5 * trial.log_square_of_n) for trial in trials])
    mean = weights @ values / weights.sum()
    spread = float(np.sqrt(weights @ (values - mean) ** 2 / weights.sum()))
    return MarkovFit(best, likelihood, maximum, spread)


def _correlation_times(full: Likelihood) -> Array:
    """Return the correlation times to try, s; none for a short record."""
    dt = full.tau[0] / full.factors[0]
    shortest, longest = _MIN_CORRELATION_SAMPLES * dt, full.duration / _MIN_RECORD_PER_TIME
    return np.geomspace(shortest, longest, _TIMES) if longest > 2.0 * shortest else np.empty(0)


def _at_time(full: Likelihood, active: tuple[int, ...], start: LikelihoodMaximum, time: float) -> _Trial:
    """Return the most probable process of a correlation time, s, fitted together with the terms."""
    unit = _unit_variance(full.tau, time)
    largest = float(np.log(np.min(full.avar / unit)))
    beside, terms = replace(full, correlated=unit), list(active)
    x = beside.starting_point(active, start.x)

    def evaluate(points: Array) -> tuple[Array, Array]:
        """Return the parts of the cost at M points of the terms and the logarithm of the size."""
        vectors = np.tile(x, (len(points), 1))
        vectors[:, terms] = points[:, :-1]
        beside.correlated = np.exp(points[:, -1:]) * unit
        return beside.cost_parts(vectors)

    low, high = beside.bounds(active)
    solution, cost = minimise(
        evaluate,
        np.append(x[terms], largest + _START_LOG_SIZE),
        np.append(low, largest - _MAX_LOG_SIZE_BELOW_POINTS),
        np.append(high, largest + _MAX_LOG_SIZE_ABOVE_POINTS),
    )
    return _Trial(MarkovNoise(float(np.exp(0.5 * solution[-1])), time), cost, float(solution[terms.index(N)]))
