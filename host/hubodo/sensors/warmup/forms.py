"""Candidate forms of the warm-up drift, each fitted jointly with white noise, flicker and a random walk.

    none              c2
    exponential       c2 + c1 (1 - e^(-t/T))
    two exponentials  c2 + c1 (1 - e^(-t/T)) + c1' (1 - e^(-t/T'))
    relaxation        c2 + sum of a_k (1 - e^(-t/T_k)), T_k evenly spaced in their logarithm, a_k ~ N(0, s²)

t is the time since power-on. The relaxation is non-parametric: power laws, 1/√(1 + t/tau), stretched
exponentials and sums of these are such mixtures (Bernstein's theorem). Its T_k extend far beyond the record,
because the record does not show drift that is still to come. With a thermometer, each form has an additional
term k (temperature - 25 °C).

Linear parameters are integrated out. Time constants and noise levels maximise the marginal likelihood
(MacKay, Neural Computation 4, 1992); the evidence of a time constant uses Laplace's approximation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import LinAlgError, cho_solve
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.optimize import minimize

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.effects.warmup import warmup_fraction

CholeskyFactor = tuple[Array, bool]
"""Cholesky factor of a covariance in the form that `cho_solve` takes."""

WARMUP_FORMS = ("none", "exponential", "two exponentials", "relaxation")

_EXPONENTIAL_COUNT = {"none": 0, "exponential": 1, "two exponentials": 2, "relaxation": 0}
_TIME_CONSTANT_RATIO, _MAX_TIME_CONSTANT_PER_AGE = 2.0, 30.0
"""Ratio of neighbouring time constants of a relaxation, and of the longest to the age at the record's end."""
_USUAL_WARMTH = 10.0  # °C, keeps powers of the temperature of similar size
_FLICKER_TIME_CONSTANT_RATIO, _MAX_FLICKER_TIME_S = 5.0, 1e5
"""Flicker as in `fuse/heading_filter.py`: ratio of neighbouring time constants, and the longest one."""
_OFFSET_PRIOR_SIGMA, _C1_PRIOR_SIGMA, _LOG_TIME_CONSTANT_PRIOR_SIGMA = 100.0, 3.0, 1.5
"""Prior sigmas: of c2 and k, and of c1, in standard deviations of the means.

Of ln T about half the record.
"""
_MIN_LOG_NOISE, _MAX_LOG_NOISE = math.log(1e-4), math.log(30.0)
"""Bounds of the logarithms of noise levels and of s, in standard deviations of the means."""
_QUIET_LOG_NOISE_RATIO = math.log(0.01)
"""Logarithm of the ratio of slow to white noise that stands for none: some hundred means do not show it."""
_MIN_LOG_NOISE_RATIO, _LOG_NOISE_OFFSETS = math.log(0.2), (-1.1, 0.0, 1.1)
"""Logarithms: slow noise is unobservable below this ratio to white noise.

Offsets from the best noise level.
"""


@dataclass(frozen=True)
class RecordNoise:
    """The noise levels of a record.

    Attributes:
        white: standard deviation of one mean, rad/s.
        flicker: bias instability B, rad/s.
        walk: rate random walk K, rad/s/√s.
        start: time at which the random walk is zero, s.
        shortest_time_constant: shortest time constant of the flicker, s.
    """

    white: float
    flicker: float
    walk: float
    start: float
    shortest_time_constant: float

    def slow_covariance(self, a: Array, b: Array) -> Array:
        """Return the (M, N) covariance of flicker and walk between ages a (M,) and b (N,), (rad/s)²."""
        x, y = a[:, None] - self.start, b[None, :] - self.start
        walk = np.where(x * y > 0.0, np.minimum(np.abs(x), np.abs(y)), 0.0)
        separation = np.abs(x - y)
        flicker = sum(np.exp(-separation / tau) for tau in self._flicker_time_constants())
        return np.asarray(self.walk**2 * walk + self._component_variance() * flicker)

    def slow_variance(self, a: Array) -> Array:
        """Return the (M,) variance of flicker and walk at ages a (M,), (rad/s)²."""
        flicker = self._component_variance() * len(self._flicker_time_constants())
        return np.asarray(self.walk**2 * np.abs(a - self.start) + flicker)

    def _component_variance(self) -> float:
        return self.flicker**2 * math.log(_FLICKER_TIME_CONSTANT_RATIO) / math.pi

    def _flicker_time_constants(self) -> Array:
        count = max(
            1,
            math.ceil(
                math.log(_MAX_FLICKER_TIME_S / self.shortest_time_constant)
                / math.log(_FLICKER_TIME_CONSTANT_RATIO)
            ),
        )
        return np.asarray(
            self.shortest_time_constant * _FLICKER_TIME_CONSTANT_RATIO ** np.arange(count), np.float64
        )


@dataclass(frozen=True)
class FittedForm:
    """A fitted form, linearised about its estimate.

    Attributes:
        name: name of the form, one of `WARMUP_FORMS`.
        time_constants: time constants of the exponentials, s.
        exponential_sizes: c1 of each exponential, rad/s, a factor of the derivative by ln T.
        mean, covariance: posterior of the coefficients of `columns`.
        noise: noise levels.
        evidence: logarithm of the marginal likelihood.
        is_quiet: whether the form was fitted without slow noise.
        temperature_order: order of the polynomial in the temperature, if there is one.
    """

    name: str
    time_constants: tuple[float, ...]
    exponential_sizes: tuple[float, ...]
    mean: Array
    covariance: Array
    noise: RecordNoise
    evidence: float
    is_quiet: bool = False
    temperature_order: int = 1

    @property
    def polynomial(self) -> tuple[Array, Array]:
        """Return the coefficients (order,) of the powers of the temperature, and their variances."""
        terms = slice(len(self.mean) - self.temperature_order, None)
        size = _USUAL_WARMTH ** -np.arange(self.temperature_order)
        return self.mean[terms] * size, np.diag(self.covariance)[terms] * size**2

    def columns(self, t: Array, temperature: Array | None) -> Array:
        """Return the (M, P) design matrix at ages t (M,) s and temperatures (M,) °C."""
        powers = None if temperature is None else temperature_powers(temperature, self.temperature_order)
        return _design_matrix(self.time_constants, self.exponential_sizes, t, powers)


def _design_matrix(
    time_constants: tuple[float, ...],
    exponential_sizes: tuple[float, ...],
    t: Array,
    powers: Array | None,
) -> Array:
    columns = [np.ones_like(t), *(warmup_fraction(t, constant) for constant in time_constants)]
    for c1, constant in zip(exponential_sizes, time_constants, strict=False):
        columns.append(-c1 * t / constant * np.exp(-t / constant))
    if powers is not None:
        columns.extend(powers.T)
    return np.column_stack(columns)


def temperature_powers(temperature: Array, order: int) -> Array:
    """Return the (M, order) powers of the temperature difference from 25 °C, of similar sizes."""
    warmth = (temperature - REFERENCE_CELSIUS)[:, None]
    exponents = np.arange(1, order + 1)
    return np.asarray(warmth**exponents / _USUAL_WARMTH ** (exponents - 1))


@dataclass(frozen=True)
class _ScaledRecord:
    """Means normalised by `centre` and standard deviation `scale`, with unit flicker and walk kernels."""

    t: Array
    y: Array
    temperature: Array | None
    order: int
    scale: float
    centre: float
    flicker: Array
    walk: Array

    @cached_property
    def span(self) -> float:
        return float(self.t[-1] - self.t[0])

    @cached_property
    def shortest(self) -> float:
        return float(np.median(np.diff(self.t)))

    def noise(self, sizes: Array) -> RecordNoise:
        """Return the noise of levels (3,): white, flicker, and walk over the record, in units of `scale`."""
        white, flicker, walk = (float(size) * self.scale for size in sizes)
        return RecordNoise(white, flicker, walk * self.span**-0.5, float(self.t[0]), self.shortest)

    def factor(self, white: float, flicker: float, walk: float) -> CholeskyFactor:
        """Return the Cholesky factor of the means' covariance, for log noise levels in units of `scale`."""
        covariance: Array = math.exp(2.0 * flicker) * self.flicker + math.exp(2.0 * walk) * self.walk
        covariance.flat[:: len(covariance) + 1] += math.exp(2.0 * white)
        return factorise(covariance)


def fit_form(
    name: str,
    t: Array,
    values: Array,
    temperature: Array | None,
    initial_constants: tuple[float, ...],
    temperature_order: int = 1,
) -> list[FittedForm]:
    """Fit one of `WARMUP_FORMS` to means (N,) rad/s at ages t (N,) s, without and with slow noise.

    temperature: (N,) °C or None. initial_constants: initial time constants, s, one per exponential.
    temperature_order: order of the polynomial in the temperature. The noise
    levels are those of the largest marginal likelihood and their neighbours, because a record determines the
    slow noise poorly.
    """
    record = _scale_record(t, values, temperature, temperature_order)
    powers = None if temperature is None else temperature_powers(temperature, temperature_order)
    exponential_count = _EXPONENTIAL_COUNT[name]

    # The factorisation dominates the run time and does not depend on the time constants.
    factor = lru_cache(maxsize=4)(record.factor)

    @lru_cache(maxsize=4)
    def columns(time_constants: tuple[float, ...]) -> Array:
        return _design_matrix(time_constants, (), t, powers)

    def likelihood(p: Array) -> float:
        time_constants, spread = _prior(name, record, p)
        log_likelihood = _marginalise(columns(time_constants), spread, factor(*p[:3]), record.y)[2]
        return (
            log_likelihood - _negative_log_prior(p[3:], record.span) if exponential_count else log_likelihood
        )

    white = math.log(max(float(np.sqrt(np.mean(np.diff(record.y) ** 2) / 2.0)), 1e-3))
    start = np.array([white, white - 2.0, white - 1.0, *np.log(initial_constants[:exponential_count])])
    longest = math.log(record.shortest / 2.0), math.log(100.0 * record.span)
    bounds = [(_MIN_LOG_NOISE, _MAX_LOG_NOISE)] * 3 + [longest] * exponential_count
    if name == "relaxation":
        start, bounds = np.append(start, -0.5), [*bounds, (_MIN_LOG_NOISE, _MAX_LOG_NOISE)]
    best = minimize(
        lambda p: -likelihood(p), start, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40}
    ).x
    best[1:3] = np.maximum(best[1:3], best[0] + _MIN_LOG_NOISE_RATIO)
    uncertain = (1, 2, 3) if name == "relaxation" else (1, 2)
    fits = [_fit_quiet(name, record, best, likelihood, factor, bounds)]
    for steps in itertools.product(_LOG_NOISE_OFFSETS, repeat=len(uncertain)):
        p = best.copy()
        p[list(uncertain)] += steps
        fits.append(_posterior_form(name, record, p, factor(*p[:3]), likelihood(p)))
    return fits


def _fit_quiet(
    name: str,
    record: _ScaledRecord,
    start: Array,
    likelihood: Callable[[Array], float],
    factor: Callable[[float, float, float], CholeskyFactor],
    bounds: list[tuple[float, float]],
) -> FittedForm:
    """Return the form fitted without slow noise, from the parameters `start` of the form with it."""
    free = [0, *range(3, len(start))]

    def with_slow_noise_removed(p: Array) -> Array:
        complete = start.copy()
        complete[free] = p
        complete[1:3] = max(complete[0] + _QUIET_LOG_NOISE_RATIO, _MIN_LOG_NOISE)
        return complete

    best = minimize(
        lambda p: -likelihood(with_slow_noise_removed(p)),
        start[free],
        method="L-BFGS-B",
        bounds=[bounds[k] for k in free],
        options={"maxiter": 40},
    ).x
    p = with_slow_noise_removed(best)
    return replace(_posterior_form(name, record, p, factor(*p[:3]), likelihood(p)), is_quiet=True)


def _scale_record(t: Array, values: Array, temperature: Array | None, order: int) -> _ScaledRecord:
    scale, centre = float(np.std(values)) or 1.0, float(np.mean(values))
    span, shortest = float(t[-1] - t[0]), float(np.median(np.diff(t)))
    flicker = RecordNoise(0.0, 1.0, 0.0, float(t[0]), shortest).slow_covariance(t, t)
    walk = RecordNoise(0.0, 0.0, span**-0.5, float(t[0]), shortest).slow_covariance(t, t)
    return _ScaledRecord(t, (values - centre) / scale, temperature, order, scale, centre, flicker, walk)


def _prior(name: str, record: _ScaledRecord, p: Array) -> tuple[tuple[float, ...], Array]:
    """Return the time constants of a form, and the prior sigmas of its coefficients.

    p: logarithms of white, flicker and walk, then of the time constants or of s.
    """
    sizes = [_C1_PRIOR_SIGMA] * _EXPONENTIAL_COUNT[name]
    constants = tuple(map(float, np.exp(p[3:]))) if sizes else ()
    if name == "relaxation":
        first, last = 2.0 * record.shortest, _MAX_TIME_CONSTANT_PER_AGE * float(record.t[-1])
        count = max(2, math.ceil(math.log(last / first) / math.log(_TIME_CONSTANT_RATIO)))
        constants = tuple(map(float, first * _TIME_CONSTANT_RATIO ** np.arange(count)))
        sizes = [math.exp(p[3])] * count
    spread = [_OFFSET_PRIOR_SIGMA, *sizes] + (
        [] if record.temperature is None else [_OFFSET_PRIOR_SIGMA] * record.order
    )
    return constants, np.array(spread)


def _posterior_form(
    name: str, record: _ScaledRecord, p: Array, factor: CholeskyFactor, evidence: float
) -> FittedForm:
    """Return the form with the posterior of its coefficients.

    factor: Cholesky factor of the covariance of the means under p. evidence: their log marginal likelihood.
    """
    time_constants, spread = _prior(name, record, p)
    noise, nothing = record.noise(np.exp(p[:3])), np.empty(0)
    form = FittedForm(name, time_constants, (), nothing, nothing, noise, 0.0, temperature_order=record.order)
    exponential_count = _EXPONENTIAL_COUNT[name]
    log_constant_rows = slice(1 + exponential_count, 1 + 2 * exponential_count)
    if exponential_count:
        linear_mean = _posterior(form.columns(record.t, record.temperature), spread, factor, record.y)[0]
        form = replace(form, exponential_sizes=tuple(map(float, linear_mean[1 : 1 + exponential_count])))
        spread = np.insert(
            spread, 1 + exponential_count, [_LOG_TIME_CONSTANT_PRIOR_SIGMA] * exponential_count
        )
    mean, posterior_cov, _ = _posterior(form.columns(record.t, record.temperature), spread, factor, record.y)
    evidence += (
        0.5 * float(np.linalg.slogdet(2.0 * math.pi * posterior_cov[log_constant_rows, log_constant_rows])[1])
        if exponential_count
        else 0.0
    )
    # The columns of ln T include the factor c1, so their coefficients are dimensionless.
    scale = np.full(len(mean), record.scale)
    scale[log_constant_rows] = 1.0
    mean = mean * scale
    mean[0] += record.centre
    slopes = tuple(record.scale * c1 for c1 in form.exponential_sizes)
    scaled_covariance = posterior_cov * np.outer(scale, scale)
    return replace(form, exponential_sizes=slopes, mean=mean, covariance=scaled_covariance, evidence=evidence)


def factorise(covariance: Array) -> CholeskyFactor:
    """Return the Cholesky factor of a covariance, which is overwritten."""
    # The transpose of the symmetric matrix has LAPACK's memory order, so nothing is copied. LAPACK is called
    # directly, because the checks of `cho_factor` take longer than a small matrix.
    factor, info = dpotrf(covariance.T, lower=True, overwrite_a=True, clean=False)
    if info:
        raise LinAlgError(f"the covariance is not positive definite: minor {info}")
    return factor, True


def _posterior(columns: Array, spread: Array, factor: CholeskyFactor, y: Array) -> tuple[Array, Array, float]:
    """Return posterior mean and covariance of the coefficients, and the log marginal likelihood of y.

    spread: prior sigmas, with zero prior means. factor: Cholesky factor of the covariance of y.
    """
    mean, precision_factor, log_likelihood = _marginalise(columns, spread, factor, y)
    return mean, cho_solve(precision_factor, np.eye(len(spread))), log_likelihood


def _marginalise(
    columns: Array, spread: Array, factor: CholeskyFactor, y: Array
) -> tuple[Array, CholeskyFactor, float]:
    """Return posterior mean, Cholesky factor of the posterior precision, and log marginal likelihood of y."""
    solution, _ = dpotrs(factor[0], np.column_stack([columns, y]), lower=True)
    precision = columns.T @ solution[:, :-1]
    precision.flat[:: len(spread) + 1] += spread**-2
    information_vector = columns.T @ solution[:, -1]
    precision_factor = factorise(precision.T)
    mean: Array = dpotrs(precision_factor[0], information_vector, lower=True)[0]
    log_det = 2.0 * float(np.log(factor[0].diagonal()).sum() + np.log(precision_factor[0].diagonal()).sum())
    log_det += 2.0 * float(np.log(spread).sum())
    chi2 = float(y @ solution[:, -1] - information_vector @ mean)
    return mean, precision_factor, -0.5 * (chi2 + log_det + len(y) * math.log(2.0 * math.pi))


def _negative_log_prior(log_constants: Array, span: float) -> float:
    """Return the negative log prior of the time constants."""
    deviation = (log_constants - math.log(0.5 * span)) / _LOG_TIME_CONSTANT_PRIOR_SIGMA
    return float(
        0.5 * deviation @ deviation
        + len(deviation) * math.log(_LOG_TIME_CONSTANT_PRIOR_SIGMA * math.sqrt(2.0 * math.pi))
    )
