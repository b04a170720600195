"""A measured input as a smooth function of time: value, slope, integral, and how far noise got through.

A spline of degree 5 with a knot at every sample, penalised on its third differences; how much is chosen by
generalised cross-validation (Craven and Wahba 1979; P-splines: Eilers and Marx 1996).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, PPoly, make_interp_spline
from scipy.linalg import solveh_banded
from scipy.optimize import minimize_scalar

from hubodo.arrays import Array

_DEGREE = 5
_ORDER = 3
# Angular frequencies per step in (0, pi), and there: the power of the samples of a B-spline, aliases folded
# in, and that of its differences, which are penalised.
_OMEGA = (np.arange(512) + 0.5) * np.pi / 512
_SAMPLED = (
    sum(np.sinc((_OMEGA + 2 * np.pi * f) / (2 * np.pi)) ** (_DEGREE + 1) for f in (-2, -1, 0, 1, 2)) ** 2
)
_ROUGHNESS = (2.0 - 2.0 * np.cos(_OMEGA)) ** _ORDER


class Evaluated(NamedTuple):
    """A function of time at N times, (N,) each: value, two derivatives, and the integral since the start."""

    value: Array
    slope: Array
    bend: Array
    integral: Array


@dataclass(frozen=True)
class Smooth:
    """A function of time, defined on [t0, t1] s and continued by its end values.

    noise: 1 sigma of one sample as found in the residual. value_noise, slope_noise: 1 sigma of what of it is
    left in the value and, per second, in the slope; it is correlated over `memory` s.
    """

    spline: BSpline
    start: float
    end: float
    noise: float
    value_noise: float
    slope_noise: float
    memory: float

    def __call__(self, t: Array, derivative: int = 0) -> Array:
        """Value, slope or bend, by how often it is derived, at t, (N,) s; see `motion`."""
        return self.motion(t)[derivative]

    def integral(self, t: Array) -> Array:
        """From `start` to t, (N,) s; outside, the end values go on."""
        return self.motion(t).integral

    def motion(self, t: Array) -> Evaluated:
        """All of it at t, (N,) s; outside, the end values hold, slopes are zero and the integral goes on."""
        knots, pieces = self._pieces
        inside = np.clip(t, self.start, self.end)
        place = np.searchsorted(knots, inside, side="right") - 1
        np.minimum(place, len(knots) - 2, out=place)
        s = inside - knots[place]
        whole, *powers = pieces.take(place, axis=1)
        value, integral = powers[-1], powers[-1] / len(powers)
        slope = bend = np.zeros_like(s)
        # Horner's rule for all four at once.
        for count, power in zip(range(len(powers) - 1, 0, -1), powers[-2::-1], strict=True):
            bend = bend * s + 2.0 * slope
            slope = slope * s + value
            value = value * s + power
            integral = integral * s + power / count
        integral = integral * s + whole
        beyond = t - inside
        if beyond.any():
            # A nanosecond of slack: a stamp at the end itself may be rounded beyond it.
            there = np.abs(beyond) < 1e-9
            slope, bend = np.where(there, slope, 0.0), np.where(there, bend, 0.0)
            integral += value * beyond
        return Evaluated(value, slope, bend, integral)

    @cached_property
    def _pieces(self) -> tuple[Array, Array]:
        """The knots within, (M+1,) s, and (degree + 2, M): the integral up to each, and the polynomial there.

        Lowest power first. A polynomial takes a fifth of the time that a sum of B-splines does.
        """
        of = PPoly.from_spline(self.spline)
        inner = slice(_DEGREE, len(of.x) - 1 - _DEGREE)
        knots, powers = of.x[inner.start : inner.stop + 1], of.c[::-1, inner]
        step = np.diff(knots)
        over = sum(power * step ** (k + 1) / (k + 1) for k, power in enumerate(powers))
        return knots, np.vstack([np.concatenate([[0.0], np.cumsum(over)[:-1]]), powers])


def constant(value: float, start: float, end: float) -> Smooth:
    """An input that is known and does not change."""
    knots = np.concatenate([np.full(_DEGREE + 1, start), np.full(_DEGREE + 1, end)])
    return Smooth(BSpline(knots, np.full(_DEGREE + 1, value), _DEGREE), start, end, 0.0, 0.0, 0.0, 0.0)


def through(t: Array, value: Array) -> Smooth:
    """The spline through exact values; t: (N,) s, increasing, at least 6; value: (N,)."""
    spline = make_interp_spline(t, value, _DEGREE)
    return Smooth(spline, float(t[0]), float(t[-1]), 0.0, 0.0, 0.0, 0.0)


def smooth(t: Array, value: Array) -> Smooth:
    """The smooth function behind noisy samples; t: (N,) s, increasing; value: (N,).

    Raises ValueError for fewer than 10 samples.
    """
    if len(t) < 10:
        raise ValueError(f"{len(t)} samples: at least 10 are needed")
    span = float(t[-1] - t[0])
    count = max(8, round(span / float(np.median(np.diff(t)))))
    step = span / count
    knots = t[0] + step * np.arange(-_DEGREE, count + _DEGREE + 1)
    design = BSpline.design_matrix(np.clip(t, t[0], t[-1]), knots, _DEGREE, extrapolate=True)
    gram = design.T @ design
    data = np.zeros((_DEGREE + 1, gram.shape[0]))
    for k in range(_DEGREE + 1):
        data[_DEGREE - k, k:] = gram.diagonal(k)
    right = design.T @ value
    penalty = _penalty(gram.shape[0])
    # A gap in the samples leaves coefficients without data: the penalty alone carries them.
    power = float(np.ptp(value)) ** 2

    def fitted(log_weight: float) -> Array:
        banded = data.copy()
        banded[_DEGREE - _ORDER :] += np.exp(log_weight) * penalty
        banded[-1] += 1e-12
        return np.asarray(solveh_banded(banded, right, check_finite=False))

    def score(log_weight: float) -> float:
        residual = value - design @ fitted(log_weight)
        freedom = _response(log_weight).mean()
        return float(len(t) * np.log((residual @ residual / len(t) + 1e-18 * power) / (1.0 - freedom) ** 2))

    best = _lowest(score)
    weights = fitted(best)
    residual = value - design @ weights
    passed = _response(best)
    noise = float(np.sqrt(residual @ residual / len(t) / max(1.0 - passed.mean(), 1e-3)))
    share, slope_share = float(np.mean(passed**2)), float(np.mean((passed * _OMEGA) ** 2))
    return Smooth(
        BSpline(knots, weights, _DEGREE),
        float(t[0]),
        float(t[-1]),
        noise,
        noise * np.sqrt(share),
        noise * np.sqrt(slope_share) / step,
        step / max(share, 1e-6),
    )


def _penalty(size: int) -> Array:
    """Upper banded form, (4, size), of the sum of squared third differences."""
    row = np.array([-1.0, 3.0, -3.0, 1.0])
    banded = np.zeros((_ORDER + 1, size))
    for lag in range(_ORDER + 1):
        for i in range(_ORDER + 1 - lag):
            banded[_ORDER - lag, i + lag : size - _ORDER + i + lag] += row[i] * row[i + lag]
    return banded


def _response(log_weight: float) -> Array:
    """(M,) gain of the smoother at the angular frequencies _OMEGA."""
    return np.asarray(_SAMPLED / (_SAMPLED + np.exp(log_weight) * _ROUGHNESS))


def _lowest(score: Callable[[float], float], low: float = -12.0, high: float = 24.0) -> float:
    """Argument of the lowest score: a coarse walk, then golden sections."""
    grid = np.arange(low, high + 1.0, 3.0)
    values = [score(x) for x in grid]
    at = int(np.argmin(values))
    lower, upper = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
    found = minimize_scalar(score, bounds=(lower, upper), method="bounded", options={"xatol": 0.3})
    return float(found.x)
