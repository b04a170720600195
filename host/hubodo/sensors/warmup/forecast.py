"""The bias at any age, before, within and after a record, with a sigma that counts what form the warm-up has.

No record proves that a warm-up is one exponential. Each of `FORMS` is fitted beside the same noise, and their
forecasts are averaged, each weighted by how well it explains the record (Bayesian model averaging; Hoeting,
Madigan, Raftery and Volinsky, Statistical Science 14, 1999): where forms that explain it alike go apart, that
is part of the sigma, as are flicker and walk of the bias itself, which grow beyond the record.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from hubodo.sensors.warmup.forms import FORMS, Factor, FittedForm, factored, fit_form

FloatArray = NDArray[np.float64]

_MEANS = 160
"""That are fitted: the work grows with the third power of their number."""
_NEGLIGIBLE = 1e-3
"""Weight, beside the largest, below which a form is left out."""
_LIKELY = {"relaxation": 3.0}
"""Beforehand, beside 1 of each other form: that a warm-up is just so many exponentials is an assumption."""


@dataclass(frozen=True)
class Forecast:
    """t: (N,) s since power-on, means: (N,) rad/s, temperature: (N,) degrees C or None, of the record.

    forms: the fitted ones. weights: (F,) of each, their sum is 1.
    """

    t: FloatArray
    means: FloatArray
    temperature: FloatArray | None
    forms: tuple[FittedForm, ...]
    weights: FloatArray

    def at(self, age: FloatArray, temperature: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Bias and its 1 sigma, (M,) rad/s, at ages (M,) s since power-on.

        temperature: (M,) degrees C then; without, that of the record's end, as sure as the record scatters.
        """
        age = np.asarray(age, np.float64)
        pairs = zip(self.forms, self._factors, strict=True)
        found = [self._of(form, factor, age, temperature) for form, factor in pairs]
        means, variances = (np.array(row) for row in zip(*found, strict=True))
        mean = self.weights @ means
        return mean, np.sqrt(self.weights @ (variances + (means - mean) ** 2))

    def off(self, age: FloatArray, bias: FloatArray, temperature: FloatArray | None = None) -> FloatArray:
        """1 sigma, (M,) rad/s, of what is wrong with another model's bias (M,) at these ages."""
        mean, sigma = self.at(age, temperature)
        return np.hypot(sigma, bias - mean)

    @cached_property
    def _factors(self) -> list[Factor]:
        """Of the covariance of the means, for each form."""
        made = []
        for form in self.forms:
            covariance = form.noise.slow(self.t, self.t)
            covariance.flat[:: len(self.t) + 1] += form.noise.white**2
            made.append(factored(covariance))
        return made

    def _of(
        self, form: FittedForm, factor: Factor, age: FloatArray, temperature: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Bias and its variance by one form, the slow noise of that moment included."""
        warm, doubt = temperature, 0.0
        if self.temperature is not None and temperature is None:
            warm = np.full(len(age), self.temperature[-1])
            doubt = float(np.var(self.temperature) * form.mean[-1] ** 2)
        noise = form.noise
        inside = form.columns(self.t, self.temperature)
        wanted = form.columns(age, None if self.temperature is None else warm)
        between = noise.slow(age, self.t)
        solved = cho_solve(factor, between.T)
        mean = wanted @ form.mean + solved.T @ (self.means - inside @ form.mean)
        direct = wanted - solved.T @ inside
        own = noise.slow_variance(age) - np.einsum("mn,nm->m", between, solved)
        variance = np.maximum(own, 0.0) + np.einsum("mp,pq,mq->m", direct, form.covariance, direct)
        return mean, variance + doubt


def forecast(
    t: FloatArray, means: FloatArray, temperature: FloatArray | None, begin: tuple[float, ...]
) -> Forecast:
    """All forms fitted to means (N,) rad/s at ages t (N,) s, and weighed.

    temperature: (N,) degrees C, or None. begin: s, two time constants to start from.
    """
    size = max(1, len(t) // _MEANS)
    count = len(t) // size * size

    def thinned(values: FloatArray) -> FloatArray:
        return np.asarray(values[:count].reshape(-1, size).mean(axis=1), np.float64)

    t, means = thinned(t), thinned(means)
    grades = None if temperature is None else thinned(temperature)
    fitted = [fit_form(name, t, means, grades, begin) for name in FORMS]
    # Each form counts the same beforehand, however many sizes of noise it was fitted with.
    evidence = np.array(
        [one.evidence + math.log(_LIKELY.get(one.name, 1.0) / len(same)) for same in fitted for one in same]
    )
    weights = np.exp(evidence - evidence.max())
    kept = weights > _NEGLIGIBLE
    forms = tuple(one for one, keep in zip(itertools.chain(*fitted), kept, strict=True) if keep)
    return Forecast(t, means, grades, forms, weights[kept] / weights[kept].sum())
