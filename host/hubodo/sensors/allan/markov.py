"""Correlated noise of IEEE 952: a first-order Gauss-Markov process beside the five terms of a fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hubodo.arrays import Array
from hubodo.sensors.allan.likelihood import BAND, B, K, Likelihood, LikelihoodMaximum, N

_PROCESS_CLAIM_COST = 25.0
"""Decrease of -2 ln likelihood from which the process counts as shown; a search over times is included."""
_MIN_CORRELATION_SAMPLES = 8.0
"""Shorter correlation is that of the sensor's bandwidth."""
_MIN_RECORD_PER_TIME = 20.0
_TIMES = 16
_MIN_OCTAVES, _MAX_WHITE_RATIO = 8, 0.65
_MAX_LOG_SIZE_BELOW_POINTS = 8.0


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
    costs = np.array([maximum.cost for _, _, maximum in trials])
    at = int(np.argmin(costs))
    around = np.log([times[max(at - 1, 0)], times[min(at + 1, len(times) - 1)]])
    refined = minimize_scalar(
        lambda log_time: _at_time(full, active, plain, float(np.exp(log_time)))[2].cost,
        bounds=around,
        method="bounded",
        options={"xatol": 0.02},
    ).x
    trials.append(_at_time(full, active, plain, float(np.exp(refined))))
    costs = np.array([maximum.cost for _, _, maximum in trials])
    best, likelihood, maximum = trials[int(np.argmin(costs))]
    if plain.cost - maximum.cost < _PROCESS_CLAIM_COST:
        return None
    weights = np.exp(-0.5 * (costs - costs.min()))
    values = np.array([np.exp(0.5 * trial.x[N]) for _, _, trial in trials])
    mean = weights @ values / weights.sum()
    spread = float(np.sqrt(weights @ (values - mean) ** 2 / weights.sum()))
    return MarkovFit(best, likelihood, maximum, spread)


def _correlation_times(full: Likelihood) -> Array:
    """Return the correlation times to try, s; none for a short record."""
    dt = full.tau[0] / full.factors[0]
    shortest, longest = _MIN_CORRELATION_SAMPLES * dt, full.duration / _MIN_RECORD_PER_TIME
    return np.geomspace(shortest, longest, _TIMES) if longest > 2.0 * shortest else np.empty(0)


def _at_time(
    full: Likelihood, active: tuple[int, ...], start: LikelihoodMaximum, time: float
) -> tuple[MarkovNoise, Likelihood, LikelihoodMaximum]:
    """Return the process of the most probable size for a correlation time, s, and the fit beside it."""
    unit = _unit_variance(full.tau, time)
    largest = float(np.log(np.min(full.avar / unit)))

    def beside(log_size: float) -> tuple[Likelihood, LikelihoodMaximum]:
        likelihood = replace(full, correlated=np.exp(log_size) * unit)
        return likelihood, likelihood.maximise(active, start.x)

    size = minimize_scalar(
        lambda log_size: beside(log_size)[1].cost,
        bounds=(largest - _MAX_LOG_SIZE_BELOW_POINTS, largest + 0.7),
        method="bounded",
        options={"xatol": 0.02},
    ).x
    return MarkovNoise(float(np.exp(0.5 * size)), time), *beside(float(size))
