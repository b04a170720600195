"""Forecast of the bias at any age, with a sigma that includes the unknown form of the warm-up.

No record proves that a warm-up is one exponential. Each of `WARMUP_FORMS` is fitted with the same noise
model, and the forecasts are averaged with the forms' evidence as weights (Bayesian model averaging;
Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999). The spread between equally likely
forms is part of the sigma, as are flicker and random walk of the bias, which grow beyond the record.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.linalg import cho_solve

from hubodo.arrays import Array
from hubodo.sensors.warmup.forms import (
    WARMUP_FORMS,
    CholeskyFactor,
    FittedForm,
    factorise,
    fit_form,
    temperature_powers,
)

StatedForm = Literal["exponential", "two exponentials"]
"""A form that the user states, in place of the average of all."""
SIGMA_HORIZON_S = 3.0 * 3600.0
"""The sigmas of an accepted model hold up to this time beyond the record, s."""
_FORECAST_MEANS = 160
"""Number of means that are fitted; the run time grows with its third power."""
_KNOWN_SHARES, _CHECK_MEANS, _MIN_PART_MEANS = (0.5, 0.67), 60, 4
"""Parts of the record that forecast the rest, their number of means, and the least in a third of the rest."""
_MIN_RELATIVE_WEIGHT = 1e-3
"""Forms with a smaller weight, relative to the largest, are dropped."""
_QUIET_LOG_PRIOR = 3.0
"""Logarithm of the prior odds of no slow noise: it changes the bias only where the record shows it."""
_SIMPLICITY_WEIGHTS = {"none": 0.1, "exponential": 1.0, "two exponentials": 0.5, "relaxation": 0.03}
"""Further prior weights of the forms in the bias, not in its sigma: simple forms are preferred."""
_FORM_PRIOR_WEIGHTS = {"relaxation": 3.0}
"""Prior weight, 1 for other forms: few warm-ups are exactly one or two exponentials."""


@dataclass(frozen=True)
class BiasForecast:
    """The weighted average of the fitted forms.

    Attributes:
        t, means, temperature: (N,) s since power-on, rad/s, and °C or None, of the record.
        forms: fitted forms.
        weights: (F,) weights of the forms in the sigma, with sum 1.
        mean_weights: (F,) weights of the forms in the bias, with sum 1. Slow noise that the record does not
            show increases the sigma but does not change the bias.
        rounding: 1σ of the error of all means that rounding to steps causes, rad/s.
        inflation: factor of all sigmas, 1 or more, by which a forecast from the first part of the record
            missed the rest; see `forecast_inflation`.
    """

    t: Array
    means: Array
    temperature: Array | None
    forms: tuple[FittedForm, ...]
    weights: Array
    mean_weights: Array
    rounding: float = 0.0
    inflation: float = 1.0

    def predict(self, age: Array, temperature: Array | None = None) -> tuple[Array, Array]:
        """Return bias and sigma, (M,) rad/s, at ages (M,) s since power-on.

        temperature: (M,) °C at those ages; if None, the temperature at the end of the record, with the
        variance of the record.
        """
        age = np.asarray(age, np.float64)
        pairs = zip(self.forms, self._factors, strict=True)
        predictions = [self._predict_form(form, factor, age, temperature) for form, factor in pairs]
        means, variances = (np.array(row) for row in zip(*predictions, strict=True))
        mean = self.mean_weights @ means
        variance = self.weights @ (variances + (means - mean) ** 2)
        return mean, np.sqrt(self.inflation**2 * variance + self.rounding**2)

    def model_error(self, age: Array, bias: Array, temperature: Array | None = None) -> Array:
        """Return the rms error, (M,) rad/s, of another model that predicts `bias` (M,) at these ages."""
        mean, sigma = self.predict(age, temperature)
        return np.hypot(sigma, bias - mean)

    def polynomial_error(self, coefficients: Array) -> Array:
        """Return the rms errors, (order,), of another model's coefficients of the temperature.

        They contain flicker and random walk of the bias, which a slow change of the temperature resembles.
        """
        polynomials = [form.polynomial for form in self.forms]
        variance = sum(
            weight * (own + (mean - coefficients) ** 2)
            for weight, (mean, own) in zip(self.weights, polynomials, strict=True)
        )
        return np.asarray(self.inflation * np.sqrt(variance))

    @cached_property
    def _factors(self) -> list[CholeskyFactor]:
        """Return the Cholesky factors of the covariance of the means under each form."""
        factors = []
        for form in self.forms:
            covariance = form.noise.slow_covariance(self.t, self.t)
            covariance.flat[:: len(self.t) + 1] += form.noise.white**2
            factors.append(factorise(covariance))
        return factors

    def _predict_form(
        self, form: FittedForm, factor: CholeskyFactor, age: Array, temperature: Array | None
    ) -> tuple[Array, Array]:
        """Return bias and variance of one form, including the slow noise at that age."""
        temperatures, temperature_variance = temperature, 0.0
        if self.temperature is not None and temperature is None:
            temperatures = np.full(len(age), self.temperature[-1])
            powers = temperature_powers(self.temperature, form.temperature_order)
            temperature_variance = float(np.var(powers @ form.mean[-form.temperature_order :]))
        noise = form.noise
        record_columns = form.columns(self.t, self.temperature)
        age_columns = form.columns(age, None if self.temperature is None else temperatures)
        cross_covariance = noise.slow_covariance(age, self.t)
        solved = cho_solve(factor, cross_covariance.T)
        mean = age_columns @ form.mean + solved.T @ (self.means - record_columns @ form.mean)
        residual_columns = age_columns - solved.T @ record_columns
        slow_variance = noise.slow_variance(age) - np.einsum("mn,nm->m", cross_covariance, solved)
        variance = np.maximum(slow_variance, 0.0) + np.einsum(
            "mp,pq,mq->m", residual_columns, form.covariance, residual_columns
        )
        return mean, variance + temperature_variance


def forecast_inflation(
    t: Array,
    means: Array,
    temperature: Array | None,
    initial_constants: tuple[float, ...],
    temperature_order: int = 1,
    stated_form: StatedForm | None = None,
) -> float:
    """Return the rms error of forecasts of the rest of the record from its first part, in sigma; at least 1.

    Parameters as in `fit_forecast`. A bias that something else than a warm-up moves, such as the temperature
    of a room without a thermometer, is outside all forms: their sigmas do not contain it, its own past does.
    """
    return max(
        1.0,
        *(
            _rms_of_forecast(t, means, temperature, initial_constants, share, temperature_order, stated_form)
            for share in _KNOWN_SHARES
        ),
    )


def _rms_of_forecast(
    t: Array,
    means: Array,
    temperature: Array | None,
    initial_constants: tuple[float, ...],
    share: float,
    temperature_order: int,
    stated_form: StatedForm | None,
) -> float:
    """Return the rms error, in sigma, of the thirds of what follows a share of the record; 0 if too short."""
    known = t <= t[0] + share * (t[-1] - t[0])
    if np.count_nonzero(known) < _CHECK_MEANS or np.count_nonzero(~known) < 3 * _MIN_PART_MEANS:
        return 0.0
    forecast = fit_forecast(
        t[known],
        means[known],
        None if temperature is None else temperature[known],
        initial_constants,
        n_means=_CHECK_MEANS,
        temperature_order=temperature_order,
        stated_form=stated_form,
    )
    pulls = []
    for part in np.array_split(np.flatnonzero(~known), 3):
        temperatures = None if temperature is None else np.array([temperature[part].mean()])
        bias, sigma = forecast.predict(np.array([t[part].mean()]), temperatures)
        noise = float(np.std(np.diff(means[part]))) / math.sqrt(2.0 * len(part))
        pulls.append((float(means[part].mean()) - float(bias[0])) / math.hypot(float(sigma[0]), noise))
    return float(np.sqrt(np.mean(np.square(pulls))))


def fit_forecast(
    t: Array,
    means: Array,
    temperature: Array | None,
    initial_constants: tuple[float, ...],
    n_means: int = _FORECAST_MEANS,
    temperature_order: int = 1,
    stated_form: StatedForm | None = None,
) -> BiasForecast:
    """Fit all forms to means (N,) rad/s at ages t (N,) s, and weight them by their evidence.

    temperature: (N,) °C or None. initial_constants: two initial time constants, s. n_means: number of means
    that they are averaged to. temperature_order: order of the polynomial in the temperature. stated_form:
    the only form, which is then believed: its sigma has the slow noise that the record shows.
    """
    size = max(1, len(t) // n_means)
    count = len(t) // size * size

    def block_means(values: Array) -> Array:
        return np.asarray(values[:count].reshape(-1, size).mean(axis=1), np.float64)

    t, means = block_means(t), block_means(means)
    temperatures = None if temperature is None else block_means(temperature)
    fitted = [
        fit_form(name, t, means, temperatures, initial_constants, temperature_order)
        for name in (WARMUP_FORMS if stated_form is None else (stated_form,))
    ]
    # The prior weight of a form does not depend on the number of noise levels it was fitted with.
    forms = tuple(itertools.chain(*fitted))
    log_weights = np.array(
        [
            form.evidence
            + math.log(_FORM_PRIOR_WEIGHTS.get(form.name, 1.0) / (1 if form.is_quiet else len(fits) - 1))
            for fits in fitted
            for form in fits
        ]
    )
    quiet = np.array([form.is_quiet for form in forms])
    quiet_prior = -np.inf if stated_form is None else _QUIET_LOG_PRIOR
    weights = _normalised(log_weights + np.where(quiet, quiet_prior, 0.0))
    simplicity = np.array([math.log(_SIMPLICITY_WEIGHTS[form.name]) for form in forms])
    mean_weights = _normalised(log_weights + simplicity + np.where(quiet, _QUIET_LOG_PRIOR, 0.0))
    used = np.maximum(weights / weights.max(), mean_weights / mean_weights.max()) > _MIN_RELATIVE_WEIGHT
    weights, mean_weights = weights[used], mean_weights[used]
    return BiasForecast(
        t,
        means,
        temperatures,
        tuple(form for form, is_used in zip(forms, used, strict=True) if is_used),
        weights / weights.sum(),
        mean_weights / mean_weights.sum(),
    )


def _normalised(log_weights: Array) -> Array:
    """Return weights with sum 1 from their logarithms."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())
