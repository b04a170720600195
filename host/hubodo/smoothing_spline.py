"""A smooth function of time through noisy samples: value, slope, integral, and residual noise.

A spline of degree 5 with a knot at every sample, penalised on its third differences; the weight of the
penalty is chosen by generalised cross-validation (Craven and Wahba 1979; P-splines: Eilers and Marx 1996).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, PPoly, make_interp_spline
from scipy.linalg import cho_solve_banded, cholesky_banded, solveh_banded
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array

from hubodo.arrays import Array

_SPLINE_DEGREE = 5
_PENALTY_ORDER = 3
# Extension of the spline at both ends, s: times at an end may be rounded beyond it, or shifted by the step of
# a numerical derivative, and there the slope must not jump to zero.
_END_TOLERANCE = 1e-6
# Share of the squares of samples that a filter may ignore.
_NEGLIGIBLE_SQUARES = 1e-6
# Angular frequencies in (0, pi) rad per sample, and at each of them the power of a sampled B-spline including
# its aliases and the power of its penalised differences.
_ANGULAR_FREQUENCIES = (np.arange(512) + 0.5) * np.pi / 512
_BASIS_POWER = (
    sum(
        np.sinc((_ANGULAR_FREQUENCIES + 2 * np.pi * f) / (2 * np.pi)) ** (_SPLINE_DEGREE + 1)
        for f in (-2, -1, 0, 1, 2)
    )
    ** 2
)
_PENALTY_POWER = (2.0 - 2.0 * np.cos(_ANGULAR_FREQUENCIES)) ** _PENALTY_ORDER


class SplineValues(NamedTuple):
    """Values of a spline at N times, (N,) each: value, two derivatives, and the integral since the start."""

    value: Array
    slope: Array
    second_derivative: Array
    integral: Array


@dataclass(frozen=True)
class SmoothingSpline:
    """A function of time, defined on [start, end] s and continued by its end values.

    Attributes
    ----------
    spline : the function.
    start, end : times between which the spline is defined, s.
    noise : 1 sigma of one sample, estimated from the residual.
    value_noise, slope_noise : 1 sigma of the residual noise of the value and, per second, of the slope.
    correlation_time : correlation time of the residual noise, s.
    cutoff : frequency at which the gain of the smoother is one half, Hz.
    """

    spline: BSpline
    start: float
    end: float
    noise: float
    value_noise: float
    slope_noise: float
    correlation_time: float
    cutoff: float = np.inf

    def __call__(self, t: Array, derivative: int = 0) -> Array:
        """Return value, slope or second derivative, for `derivative` 0, 1 or 2, at t, (N,) s."""
        return self.evaluate(t)[derivative]

    def integral(self, t: Array) -> Array:
        """Return the integral from `start` to t, (N,) s; outside, the end values continue."""
        return self.evaluate(t).integral

    def evaluate(self, t: Array) -> SplineValues:
        """Return value, derivatives and integral at t, (N,) s.

        Outside the spline the end values continue: slopes are zero and the integral grows linearly.
        """
        knots, coefficients = self._polynomials
        inside = np.clip(t, self.start, self.end)
        piece = np.searchsorted(knots, inside, side="right") - 1
        np.minimum(piece, len(knots) - 2, out=piece)
        s = inside - knots[piece]
        integral_before, *powers = coefficients.take(piece, axis=1)
        value, integral = powers[-1], powers[-1] / len(powers)
        slope = second_derivative = np.zeros_like(s)
        # Horner's rule for all four at once.
        for count, power in zip(range(len(powers) - 1, 0, -1), powers[-2::-1], strict=True):
            second_derivative = second_derivative * s + 2.0 * slope
            slope = slope * s + value
            value = value * s + power
            integral = integral * s + power / count
        integral = integral * s + integral_before
        beyond = t - inside
        if beyond.any():
            at_end = np.abs(beyond) < _END_TOLERANCE
            slope, second_derivative = np.where(at_end, slope, 0.0), np.where(at_end, second_derivative, 0.0)
            integral += value * beyond
        return SplineValues(value, slope, second_derivative, integral)

    @cached_property
    def _polynomials(self) -> tuple[Array, Array]:
        """Return the inner knots, (M+1,) s, and the polynomial of each interval, (degree + 2, M).

        The first row is the integral up to the interval; coefficients follow from the lowest power on.
        Polynomials take a fifth of the time of a sum of B-splines.
        """
        polynomial = PPoly.from_spline(self.spline)
        inner = slice(_SPLINE_DEGREE, len(polynomial.x) - 1 - _SPLINE_DEGREE)
        knots, powers = polynomial.x[inner.start : inner.stop + 1], polynomial.c[::-1, inner]
        step = np.diff(knots)
        piece_integrals = sum(power * step ** (k + 1) / (k + 1) for k, power in enumerate(powers))
        return knots, np.vstack([np.concatenate([[0.0], np.cumsum(piece_integrals)[:-1]]), powers])


def constant_spline(value: float, start: float, end: float) -> SmoothingSpline:
    """Return a spline that is a noise-free constant between two times."""
    knots = np.concatenate([np.full(_SPLINE_DEGREE + 1, start), np.full(_SPLINE_DEGREE + 1, end)])
    return SmoothingSpline(
        BSpline(knots, np.full(_SPLINE_DEGREE + 1, value), _SPLINE_DEGREE), start, end, 0.0, 0.0, 0.0, 0.0
    )


def fit_interpolating_spline(t: Array, value: Array) -> SmoothingSpline:
    """Return the spline through exact values; t: (N,) s, increasing, at least 6; value: (N,)."""
    spline = make_interp_spline(t, value, _SPLINE_DEGREE)
    return SmoothingSpline(spline, float(t[0]), float(t[-1]), 0.0, 0.0, 0.0, 0.0)


def fit_smoothing_spline(t: Array, value: Array, max_frequency: float = np.inf) -> SmoothingSpline:
    """Return the smooth function behind noisy samples; t: (N,) s, increasing; value: (N,).

    Noise that is not white looks like signal to cross-validation; `max_frequency`, Hz, is the frequency at
    which the gain of the smoother is at most one half. Raises ValueError for fewer than 10 samples.
    """
    if len(t) < 10:
        raise ValueError(f"{len(t)} samples: at least 10 are needed")
    span = float(t[-1] - t[0])
    count = max(8, round(span / float(np.median(np.diff(t)))))
    step = span / count
    knots, design, data = _build_design(t, step, count)
    right_hand_side = design.T @ value
    penalty = _banded_penalty(data.shape[1])
    # In a gap between samples the penalty alone determines the coefficients.
    value_range_squared = float(np.ptp(value)) ** 2

    def fit_coefficients(log_weight: float) -> Array:
        banded = _add_penalty(data, penalty, log_weight)
        return np.asarray(solveh_banded(banded, right_hand_side, check_finite=False))

    def score(log_weight: float) -> float:
        residual = value - design @ fit_coefficients(log_weight)
        freedom = _smoother_gain(log_weight).mean()
        return float(
            len(t)
            * np.log((residual @ residual / len(t) + 1e-18 * value_range_squared) / (1.0 - freedom) ** 2)
        )

    best = max(_minimise(score), _log_weight_at(2.0 * np.pi * max_frequency * step))
    weights = fit_coefficients(best)
    residual = value - design @ weights
    gain = _smoother_gain(best)
    noise = float(np.sqrt(residual @ residual / len(t) / max(1.0 - gain.mean(), 1e-3)))
    value_gain, slope_gain = float(np.mean(gain**2)), float(np.mean((gain * _ANGULAR_FREQUENCIES) ** 2))
    return SmoothingSpline(
        BSpline(knots, weights, _SPLINE_DEGREE),
        float(t[0]),
        float(t[-1]),
        noise,
        noise * np.sqrt(value_gain),
        noise * np.sqrt(slope_gain) / step,
        step / max(value_gain, 1e-6),
        float(np.exp(-best / (2 * _PENALTY_ORDER)) / (2.0 * np.pi * step)),
    )


class LowPass:
    """The smoother of a spline as a linear filter of other samples.

    An error of samples that were smoothed is smoothed with them: what a filter removes needs no correction.
    """

    def __init__(self, t: Array, cutoff: float) -> None:
        """Prepare the filter; t: (N,) s, increasing; cutoff: Hz."""
        count = max(8, round(float(t[-1] - t[0]) / float(np.median(np.diff(t)))))
        step = float(t[-1] - t[0]) / count
        # The power of penalised differences at a low angular frequency is its sixth power.
        self._log_weight = -2 * _PENALTY_ORDER * float(np.log(2.0 * np.pi * cutoff * step))
        if np.isfinite(self._log_weight):
            _knots, self._design, data = _build_design(t, step, count)
            banded = _add_penalty(data, _banded_penalty(data.shape[1]), self._log_weight)
            self._factor = cholesky_banded(banded, overwrite_ab=True, check_finite=False)

    def apply(self, values: Array) -> Array:
        """Return samples, (N,), without what is faster than the cut-off; as they are if nothing is."""
        # The smoother minimises the squares of what it removes plus the penalty, so the penalty is a bound.
        removed = np.exp(self._log_weight) * float(np.sum(np.diff(values, _PENALTY_ORDER) ** 2))
        if removed <= _NEGLIGIBLE_SQUARES * float(values @ values):
            return values
        return np.asarray(
            self._design
            @ cho_solve_banded((self._factor, False), self._design.T @ values, check_finite=False)
        )


def _build_design(t: Array, step: float, count: int) -> tuple[Array, csr_array, Array]:
    """Return knots, design matrix, and its gram matrix in upper banded form, (degree + 1, K)."""
    knots = t[0] + step * np.arange(-_SPLINE_DEGREE, count + _SPLINE_DEGREE + 1)
    design = BSpline.design_matrix(np.clip(t, t[0], t[-1]), knots, _SPLINE_DEGREE, extrapolate=True)
    gram = design.T @ design
    data = np.zeros((_SPLINE_DEGREE + 1, gram.shape[0]))
    for k in range(_SPLINE_DEGREE + 1):
        data[_SPLINE_DEGREE - k, k:] = gram.diagonal(k)
    return knots, design, data


def _add_penalty(data: Array, penalty: Array, log_weight: float) -> Array:
    banded = data.copy()
    banded[_SPLINE_DEGREE - _PENALTY_ORDER :] += np.exp(log_weight) * penalty
    banded[-1] += 1e-12
    return banded


def _banded_penalty(size: int) -> Array:
    """Return the sum of squared third differences in upper banded form, (4, size)."""
    row = np.array([-1.0, 3.0, -3.0, 1.0])
    banded = np.zeros((_PENALTY_ORDER + 1, size))
    for lag in range(_PENALTY_ORDER + 1):
        for i in range(_PENALTY_ORDER + 1 - lag):
            banded[_PENALTY_ORDER - lag, i + lag : size - _PENALTY_ORDER + i + lag] += row[i] * row[i + lag]
    return banded


def _smoother_gain(log_weight: float) -> Array:
    """Return the gain of the smoother at _ANGULAR_FREQUENCIES, (M,)."""
    return np.asarray(_BASIS_POWER / (_BASIS_POWER + np.exp(log_weight) * _PENALTY_POWER))


def _log_weight_at(angular_frequency: float) -> float:
    """Return the logarithm of the penalty's weight at which the gain at a frequency is one half.

    It is -inf for a frequency beyond _ANGULAR_FREQUENCIES.
    """
    k = int(np.searchsorted(_ANGULAR_FREQUENCIES, angular_frequency))
    if k == len(_ANGULAR_FREQUENCIES):
        return -np.inf
    power: Array = np.asarray(_BASIS_POWER)
    return float(np.log(power[k] / _PENALTY_POWER[k]))


def _minimise(score: Callable[[float], float], low: float = -12.0, high: float = 24.0) -> float:
    """Return the minimiser of a score: a coarse grid, then a bounded search."""
    grid = np.arange(low, high + 1.0, 3.0)
    values = [score(x) for x in grid]
    lowest = int(np.argmin(values))
    lower, upper = grid[max(lowest - 1, 0)], grid[min(lowest + 1, len(grid) - 1)]
    minimum = minimize_scalar(score, bounds=(lower, upper), method="bounded", options={"xatol": 0.3})
    return float(minimum.x)
