"""Forms that a warm-up may have, each fitted beside white noise, flicker and a random walk.

    none              c2
    exponential       c2 + c1 (1 - e^(-t/T))
    two exponentials  c2 + c1 (1 - e^(-t/T)) + c1' (1 - e^(-t/T'))
    relaxation        c2 + sum of a_k (1 - e^(-t/T_k)), T_k evenly spaced in their logarithm, a_k ~ N(0, s²)

The last has no form of its own: power laws, 1/√(1 + t/tau), stretched exponentials and sums of all these are
such mixtures (Bernstein's theorem). Its T_k go far beyond the record, which cannot show what is yet to come.
Where there is a thermometer each form has k (temperature - 25 °C) beside it.

All but time constants and sizes of noise enter linearly and are integrated over; those are where the marginal
likelihood is largest (MacKay, Neural Computation 4, 1992), and the evidence of a time constant is Laplace's.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from hubodo.effects.base import REFERENCE_CELSIUS
from hubodo.effects.warmup import warmup_fraction

FloatArray = NDArray[np.float64]
Factor = tuple[FloatArray, bool]
"""Of a covariance, as `cho_solve` takes it."""

FORMS = ("none", "exponential", "two exponentials", "relaxation")

_EXPONENTIALS = {"none": 0, "exponential": 1, "two exponentials": 2, "relaxation": 0}
_RATIO, _BEYOND = 2.0, 30.0
"""Of neighbouring time constants of a relaxation, and of the longest to the age of the record's end."""
_FLICKER_RATIO, _FLICKER_S = 5.0, 1e5
"""Flicker is made as in `fuse/heading_filter.py`: ratio of neighbouring time constants, and the longest."""
_WIDE, _USUAL, _LOG_T = 100.0, 3.0, 1.5
"""1 sigma beforehand, in scatters of the means: of c2 and k, of c1; and of ln T about half a record."""
_LEAST, _MOST = math.log(1e-4), math.log(30.0)
"""Logarithms of sizes of noise and of s in those units."""
_UNSEEN, _DOUBT = math.log(0.2), (-1.1, 0.0, 1.1)
"""Logarithms: noise this far below the white one is not seen; how far a size may be from the likeliest."""


@dataclass(frozen=True)
class RecordNoise:
    """What stands beside a form in a record, 1 sigma.

    white: of a mean, rad/s. flicker: B, rad/s. walk: K, rad/s/√s. begin: s, where the walk is zero. shortest:
    s, the shortest time constant of the flicker.
    """

    white: float
    flicker: float
    walk: float
    begin: float
    shortest: float

    def slow(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(M, N) covariance of flicker and walk between ages (M,) and (N,), (rad/s)²."""
        x, y = a[:, None] - self.begin, b[None, :] - self.begin
        walk = np.where(x * y > 0.0, np.minimum(np.abs(x), np.abs(y)), 0.0)
        apart = np.abs(x - y)
        flicker = sum(np.exp(-apart / tau) for tau in self._constants())
        made: FloatArray = self.walk**2 * walk + self._each() * flicker
        return made

    def slow_variance(self, a: FloatArray) -> FloatArray:
        """(M,) the same of each age with itself."""
        made: FloatArray = self.walk**2 * np.abs(a - self.begin) + self._each() * len(self._constants())
        return made

    def _each(self) -> float:
        return self.flicker**2 * math.log(_FLICKER_RATIO) / math.pi

    def _constants(self) -> FloatArray:
        count = max(1, math.ceil(math.log(_FLICKER_S / self.shortest) / math.log(_FLICKER_RATIO)))
        return np.asarray(self.shortest * _FLICKER_RATIO ** np.arange(count), np.float64)


@dataclass(frozen=True)
class FittedForm:
    """A form with its parameters, linear about where they were found.

    constants: s, time constants. slopes: (P,) c1 of each exponential, for the columns of its ln T. mean,
    covariance: of what the columns multiply. evidence: logarithm of the marginal likelihood.
    """

    name: str
    constants: tuple[float, ...]
    slopes: tuple[float, ...]
    mean: FloatArray
    covariance: FloatArray
    noise: RecordNoise
    evidence: float

    def columns(self, t: FloatArray, temperature: FloatArray | None) -> FloatArray:
        """(M, P) what each parameter multiplies at ages (M,) s, temperature (M,) degrees C."""
        made = [np.ones_like(t), *(warmup_fraction(t, constant) for constant in self.constants)]
        for c1, constant in zip(self.slopes, self.constants, strict=False):
            made.append(-c1 * t / constant * np.exp(-t / constant))
        if temperature is not None:
            made.append(temperature - REFERENCE_CELSIUS)
        return np.column_stack(made)


@dataclass(frozen=True)
class _Record:
    """Means in units of their scatter about their centre; kernels of a flicker and a walk of size 1 there."""

    t: FloatArray
    y: FloatArray
    temperature: FloatArray | None
    scale: float
    centre: float
    flicker: FloatArray
    walk: FloatArray

    @cached_property
    def span(self) -> float:
        return float(self.t[-1] - self.t[0])

    @cached_property
    def shortest(self) -> float:
        return float(np.median(np.diff(self.t)))

    def noise(self, sizes: FloatArray) -> RecordNoise:
        """sizes: (3,) white, flicker, and the walk over the whole record; in units of the scatter."""
        white, flicker, walk = (float(size) * self.scale for size in sizes)
        return RecordNoise(white, flicker, walk * self.span**-0.5, float(self.t[0]), self.shortest)

    def factor(self, white: float, flicker: float, walk: float) -> Factor:
        """Of the covariance of the means; their logarithms in units of the scatter, as of `noise`."""
        made: FloatArray = math.exp(2.0 * flicker) * self.flicker + math.exp(2.0 * walk) * self.walk
        made.flat[:: len(made) + 1] += math.exp(2.0 * white)
        return factored(made)


def fit_form(
    name: str, t: FloatArray, values: FloatArray, temperature: FloatArray | None, begin: tuple[float, ...]
) -> list[FittedForm]:
    """The form `name` of FORMS fitted to means (N,) rad/s at ages t (N,) s, once for each size of the noise.

    temperature: (N,) degrees C or None. begin: s, time constants to start from, one for each exponential.
    The sizes are those of the largest marginal likelihood and their neighbours, as a record leaves in doubt
    how far the bias wanders.
    """
    record = _record(t, values, temperature)
    number = _EXPONENTIALS[name]

    # Most of the work, and the same for all time constants.
    factor = lru_cache(maxsize=4)(record.factor)

    def likelihood(p: FloatArray) -> float:
        form, spread = _form(name, record, p)
        told = _marginal(form.columns(t, temperature), spread, factor(*p[:3]), record.y)[2]
        return told - _surprise(p[3:], record.span) if number else told

    white = math.log(max(float(np.sqrt(np.mean(np.diff(record.y) ** 2) / 2.0)), 1e-3))
    start = np.array([white, white - 2.0, white - 1.0, *np.log(begin[:number])])
    longest = math.log(record.shortest / 2.0), math.log(100.0 * record.span)
    bounds = [(_LEAST, _MOST)] * 3 + [longest] * number
    if name == "relaxation":
        start, bounds = np.append(start, -0.5), [*bounds, (_LEAST, _MOST)]
    best = minimize(
        lambda p: -likelihood(p), start, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40}
    ).x
    best[1:3] = np.maximum(best[1:3], best[0] + _UNSEEN)
    doubted = (1, 2, 3) if name == "relaxation" else (1, 2)
    made = []
    for steps in itertools.product(_DOUBT, repeat=len(doubted)):
        p = best.copy()
        p[list(doubted)] += steps
        made.append(_fitted(name, record, p, factor(*p[:3]), likelihood(p)))
    return made


def _record(t: FloatArray, values: FloatArray, temperature: FloatArray | None) -> _Record:
    scale, centre = float(np.std(values)) or 1.0, float(np.mean(values))
    span, shortest = float(t[-1] - t[0]), float(np.median(np.diff(t)))
    flicker = RecordNoise(0.0, 1.0, 0.0, float(t[0]), shortest).slow(t, t)
    walk = RecordNoise(0.0, 0.0, span**-0.5, float(t[0]), shortest).slow(t, t)
    return _Record(t, (values - centre) / scale, temperature, scale, centre, flicker, walk)


def _form(name: str, record: _Record, p: FloatArray) -> tuple[FittedForm, FloatArray]:
    """The form without its parameters, and what these are like beforehand, 1 sigma.

    p: logarithms of white, flicker and walk, then of the time constants or of s.
    """
    sizes = [_USUAL] * _EXPONENTIALS[name]
    constants = tuple(map(float, np.exp(p[3:]))) if sizes else ()
    if name == "relaxation":
        first, last = 2.0 * record.shortest, _BEYOND * float(record.t[-1])
        count = max(2, math.ceil(math.log(last / first) / math.log(_RATIO)))
        constants = tuple(map(float, first * _RATIO ** np.arange(count)))
        sizes = [math.exp(p[3])] * count
    spread = [_WIDE, *sizes] + ([] if record.temperature is None else [_WIDE])
    noise, nothing = record.noise(np.exp(p[:3])), np.empty(0)
    return FittedForm(name, constants, (), nothing, nothing, noise, 0.0), np.array(spread)


def _fitted(name: str, record: _Record, p: FloatArray, factor: Factor, evidence: float) -> FittedForm:
    """The form with its parameters; factor, evidence: of the means under p."""
    form, spread = _form(name, record, p)
    number = _EXPONENTIALS[name]
    here = slice(1 + number, 1 + 2 * number)
    if number:
        flat = _posterior(form.columns(record.t, record.temperature), spread, factor, record.y)[0]
        form = replace(form, slopes=tuple(map(float, flat[1 : 1 + number])))
        spread = np.insert(spread, 1 + number, [_LOG_T] * number)
    mean, after, _ = _posterior(form.columns(record.t, record.temperature), spread, factor, record.y)
    evidence += 0.5 * float(np.linalg.slogdet(2.0 * math.pi * after[here, here])[1]) if number else 0.0
    # The columns of ln T carry c1 themselves, so what they multiply has no scale.
    stretch = np.full(len(mean), record.scale)
    stretch[here] = 1.0
    mean = mean * stretch
    mean[0] += record.centre
    slopes = tuple(record.scale * c1 for c1 in form.slopes)
    spread_after = after * np.outer(stretch, stretch)
    return replace(form, slopes=slopes, mean=mean, covariance=spread_after, evidence=evidence)


def factored(covariance: FloatArray) -> Factor:
    """Of a covariance that is given up."""
    # As LAPACK lies in memory, so that nothing is copied; the same matrix, as it is symmetric.
    made: Factor = cho_factor(covariance.T, lower=True, overwrite_a=True, check_finite=False)
    return made


def _posterior(
    columns: FloatArray, spread: FloatArray, factor: Factor, y: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Mean and covariance of the parameters, prior N(0, spread²), and the log marginal likelihood of y.

    factor: of the covariance of y.
    """
    mean, inner, told = _marginal(columns, spread, factor, y)
    return mean, cho_solve(inner, np.eye(len(spread))), told


def _marginal(
    columns: FloatArray, spread: FloatArray, factor: Factor, y: FloatArray
) -> tuple[FloatArray, Factor, float]:
    """As `_posterior`, with the factor of the inverse of the covariance, which a search has no use for."""
    solved = cho_solve(factor, np.column_stack([columns, y]), check_finite=False)
    precision = columns.T @ solved[:, :-1]
    precision.flat[:: len(spread) + 1] += spread**-2
    drive = columns.T @ solved[:, -1]
    inner: Factor = cho_factor(precision, lower=True)
    mean: FloatArray = cho_solve(inner, drive, check_finite=False)
    log_det = 2.0 * float(np.log(factor[0].diagonal()).sum() + np.log(inner[0].diagonal()).sum())
    log_det += 2.0 * float(np.log(spread).sum())
    square = float(y @ solved[:, -1] - drive @ mean)
    return mean, inner, -0.5 * (square + log_det + len(y) * math.log(2.0 * math.pi))


def _surprise(log_constants: FloatArray, span: float) -> float:
    off = (log_constants - math.log(0.5 * span)) / _LOG_T
    return float(0.5 * off @ off + len(off) * math.log(_LOG_T * math.sqrt(2.0 * math.pi)))
