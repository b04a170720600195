"""Levenberg-Marquardt fit of a warm-up model with automatic initial values and calibrated sigmas."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.effects.warmup import (
    TEMPERATURE_PARAMETERS,
    WARMUP_PARAMETERS,
    WarmupKind,
    WarmupModel,
    warmup_fraction,
)
from hubodo.sensors.warmup.whiteness import ljung_box

# A determined parameter exceeds 4 sigma; a determined time constant has a relative sigma below one third.
_MIN_SIZE_SIGMA, _MAX_RELATIVE_SIGMA = 4.0, 1.0 / 3.0
# Number of segments whose means give the random walk of the residual.
_WALK_SEGMENTS = 20


@dataclass(frozen=True)
class WarmupFit:
    """One fitted warm-up model.

    Attributes:
        kind: form of the model, a key of `WARMUP_PARAMETERS`.
        model: bias as a function of time and temperature.
        values, sigma: parameters and their standard deviations by name, SI.
        covariance: (P, P) in the order of `WARMUP_PARAMETERS[kind]`.
        residual: (N,) of the fitted points, rad/s.
        noise: standard deviation of the residual, rad/s.
        bic: Bayesian information criterion; smaller is better.
        evaluations: number of model evaluations by Levenberg-Marquardt.
        variance_inflation: largest ratio of a variance to that for a white residual; 1 if the residual is
            white.
    """

    kind: WarmupKind
    model: WarmupModel
    values: dict[str, float]
    sigma: dict[str, float]
    covariance: Array
    residual: Array
    noise: float
    bic: float
    evaluations: int
    variance_inflation: float

    @property
    def is_determined(self) -> bool:
        """Return True if time constants are known to 1/3 (1 sigma) and sizes other than c2 exceed 4 sigma."""
        return all(
            sigma < _MAX_RELATIVE_SIGMA * self.values[name]
            if name.startswith("time_constant")
            else name == "c2"
            or self._is_lower_power(name)
            or _MIN_SIZE_SIGMA * sigma < abs(self.values[name])
            for name, sigma in self.sigma.items()
        )

    @property
    def temperature_order(self) -> int:
        """Return the order of the polynomial in the temperature, 0 without one."""
        return sum(name in self.values for name in TEMPERATURE_PARAMETERS)

    def _is_lower_power(self, name: str) -> bool:
        """Return True for a power of the temperature below the highest: it may be zero at 25 °C."""
        return name in TEMPERATURE_PARAMETERS[: max(self.temperature_order - 1, 0)]

    def bias_sigma(self, t: Array, temperature: Array | None = None) -> Array:
        """Return the bias sigma, (M,) rad/s at t (M,) s, due to the parameters if the form is correct."""
        names = WARMUP_PARAMETERS[self.kind]
        parameters = [math.log(v) if n.startswith("time_constant") else v for n, v in self.values.items()]
        slope = _jacobian(t, names, np.array(parameters), temperature)
        for k, name in enumerate(names):
            if name.startswith("time_constant"):
                slope[:, k] /= self.values[name]
        return np.asarray(np.sqrt(np.einsum("np,pq,nq->n", slope, self.covariance, slope)), np.float64)


def fit_warmup(
    t: Array, values: Array, kind: WarmupKind = "exponential", temperature: Array | None = None
) -> WarmupFit:
    """Fit a model of form `kind` to values (N,) rad/s at t (N,) s since power-on; temperature: (N,) °C.

    The initial values come from variable projection: the linear parameters are solved for at each point of
    a grid of time constants. Levenberg-Marquardt then refines the best one with the analytic Jacobian,
    with time constants as logarithms. The covariance is s^2 (J'J)^-1 for a white residual. Otherwise the
    effect of a random walk is added, with the level that the increments of the residual show.
    """
    names = WARMUP_PARAMETERS[kind]
    constants = _search_time_constants(t, values, kind, temperature)
    basis = _basis(t, constants, kind, temperature)
    linear = np.asarray(np.linalg.lstsq(basis, values, rcond=None)[0], np.float64)
    packed = _pack_parameters(names, linear, constants)

    def residual(parameters: Array) -> Array:
        model = _build_model(names, parameters)
        error: Array = model.bias(t, temperature) - values
        return error

    def jacobian(parameters: Array) -> Array:
        return _jacobian(t, names, parameters, temperature)

    scale = np.maximum(np.linalg.norm(jacobian(packed), axis=0), 1e-300)
    solution = least_squares(
        lambda p: residual(p / scale),
        packed * scale,
        lambda p: jacobian(p / scale) / scale,
        method="lm",
        xtol=1e-12,
        ftol=1e-12,
    )
    parameters = np.asarray(solution.x, float) / scale
    residuals = -residual(parameters)
    count = len(t)
    noise = float(np.sqrt(residuals @ residuals / max(1, count - len(names))))
    covariance, widened = _covariance(t, jacobian(parameters), residuals, noise)
    # Convert from the logarithm of a time constant to the time constant.
    derivative = np.array(
        [
            np.exp(p) if name.startswith("time_constant") else 1.0
            for name, p in zip(names, parameters, strict=True)
        ]
    )
    covariance *= np.outer(derivative, derivative)
    model = _build_model(names, parameters)
    return WarmupFit(
        kind,
        model,
        {name: getattr(model, name) for name in names},
        {name: float(np.sqrt(covariance[k, k])) for k, name in enumerate(names)},
        covariance,
        residuals,
        noise,
        float(count * np.log(max(float(residuals @ residuals) / count, 1e-300)) + len(names) * np.log(count)),
        int(solution.nfev),
        widened,
    )


def _search_time_constants(
    t: Array, values: Array, kind: WarmupKind, temperature: Array | None
) -> tuple[float, ...]:
    """Return the time constants of the best grid point."""
    constant_count = sum(name.startswith("time_constant") for name in WARMUP_PARAMETERS[kind])
    span = float(t[-1] - t[0])
    grid = np.geomspace(
        max(2.0 * span / len(t), span / 300.0), 10.0 * span, 24 if constant_count == 1 else 16
    )
    # A few hundred points suffice for initial values.
    stride = max(1, len(t) // 400)
    t, values = t[::stride], values[::stride]
    temperature = None if temperature is None else temperature[::stride]
    best: tuple[float, tuple[float, ...]] = (np.inf, ())
    for constants in itertools.combinations(grid, constant_count):
        basis = _basis(t, constants, kind, temperature)
        linear = np.linalg.lstsq(basis, values, rcond=None)[0]
        cost = float(np.sum((basis @ linear - values) ** 2))
        if cost < best[0]:
            best = cost, tuple(float(c) for c in constants)
    return best[1]


def _basis(t: Array, constants: tuple[float, ...], kind: WarmupKind, temperature: Array | None) -> Array:
    """Return the (N, L) design matrix of the linear parameters: constant, exponentials, temperature."""
    columns = [np.ones_like(t), *(warmup_fraction(t, constant) for constant in constants)]
    for n, name in enumerate(TEMPERATURE_PARAMETERS):
        if name in WARMUP_PARAMETERS[kind]:
            if temperature is None:
                raise ValueError(f"model {kind!r} needs the temperature")
            columns.append((temperature - REFERENCE_CELSIUS) ** (n + 1))
    return np.column_stack(columns)


def _pack_parameters(names: tuple[str, ...], linear: Array, constants: tuple[float, ...]) -> Array:
    remaining_linear, remaining_constants = iter(linear), iter(constants)
    return np.array(
        [
            np.log(next(remaining_constants)) if name.startswith("time_constant") else next(remaining_linear)
            for name in names
        ]
    )


def _build_model(names: tuple[str, ...], parameters: Array) -> WarmupModel:
    pairs = zip(names, parameters, strict=True)
    # Limits of e^±60 s avoid overflow; no record determines such time constants.
    return WarmupModel(
        **{n: float(np.exp(np.clip(p, -60, 60)) if n.startswith("time_constant") else p) for n, p in pairs}
    )


def _jacobian(t: Array, names: tuple[str, ...], parameters: Array, temperature: Array | None) -> Array:
    """Return the (N, P) derivatives of the bias, for time constants with respect to their logarithm."""
    model = _build_model(names, parameters)
    columns = []
    for name in names:
        if name == "c2":
            columns.append(np.ones_like(t))
        elif name in TEMPERATURE_PARAMETERS:
            assert temperature is not None
            power = 1 + TEMPERATURE_PARAMETERS.index(name)
            columns.append((temperature - REFERENCE_CELSIUS) ** power)
        elif name.startswith("c1"):
            constant = getattr(model, name.replace("c1", "time_constant"))
            columns.append(warmup_fraction(t, constant))
        else:
            constant, c1 = getattr(model, name), getattr(model, name.replace("time_constant", "c1"))
            columns.append(-c1 * (t / constant) * np.exp(-t / constant))
    return np.column_stack(columns)


def _covariance(t: Array, jacobian: Array, residual: Array, noise: float) -> tuple[Array, float]:
    """Return the covariance of the parameters, and its largest variance ratio to that for white noise."""
    inverse = np.linalg.pinv(jacobian)
    white_covariance = noise**2 * (inverse @ inverse.T)
    if len(residual) < 4 * _WALK_SEGMENTS or not np.ptp(residual) or ljung_box(residual).is_white:
        return white_covariance, 1.0
    segment_means = [segment.mean() for segment in np.array_split(residual, _WALK_SEGMENTS)]
    segment_duration = float(t[-1] - t[0]) / _WALK_SEGMENTS
    white = float(np.mean(np.diff(residual) ** 2)) / 2.0
    excess = float(np.mean(np.diff(segment_means) ** 2)) - 2.0 * white * _WALK_SEGMENTS / len(residual)
    walk = max(excess, 0.0) / (2.0 * segment_duration / 3.0)
    # A walk w has cov(w(s), w(t)) = K^2 min(s, t), so the variance of a weighted sum of w is K^2 times the
    # integral of the squared sum of the weights after t.
    weights_after = np.cumsum(inverse[:, ::-1], axis=1)[:, ::-1]
    steps = np.diff(t, prepend=t[0])
    covariance: Array = white_covariance + walk * (weights_after * steps) @ weights_after.T
    return covariance, float(np.max(np.diag(covariance) / np.diag(white_covariance)))
