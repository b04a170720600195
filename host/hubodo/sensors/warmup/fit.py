"""Levenberg-Marquardt fit of a warm-up model that starts by itself, with honest sigmas."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from hubodo.effects.base import REFERENCE_CELSIUS
from hubodo.effects.warmup import WARMUP_PARAMETERS, WarmupKind, WarmupModel, warmup_fraction
from hubodo.sensors.warmup.whiteness import ljung_box

FloatArray = NDArray[np.float64]


_SIGNIFICANT, _RELATIVE_SIGMA = 4.0, 1.0 / 3.0
# Parts of the record whose means tell how the residual wanders.
_PARTS = 20


@dataclass(frozen=True)
class WarmupFit:
    """One fitted model.

    values, sigma: by parameter name, SI. covariance: (P, P) in the order of PARAMETERS[kind]. residual: (N,)
    of the fitted points. noise: 1 sigma of the residual. bic: Bayes information criterion, smaller is better.
    evaluations: of the model by Levenberg-Marquardt. widened: largest ratio of a variance in the covariance
    to that for a white residual, 1 where the residual is white.
    """

    kind: WarmupKind
    model: WarmupModel
    values: dict[str, float]
    sigma: dict[str, float]
    covariance: FloatArray
    residual: FloatArray
    noise: float
    bic: float
    evaluations: int
    widened: float

    @property
    def determined(self) -> bool:
        """Whether each parameter stands: time constants to a third, sizes by four sigma. c2 may be zero."""
        return all(
            sigma < _RELATIVE_SIGMA * self.values[name]
            if name.startswith("time_constant")
            else name == "c2" or _SIGNIFICANT * sigma < abs(self.values[name])
            for name, sigma in self.sigma.items()
        )

    def spread(self, t: FloatArray, temperature: FloatArray | None = None) -> FloatArray:
        """1 sigma, (M,) rad/s, of its bias at t (M,) s, by its parameters alone: as if its form were true."""
        names = WARMUP_PARAMETERS[self.kind]
        at = [math.log(v) if n.startswith("time_constant") else v for n, v in self.values.items()]
        slope = _jacobian(t, names, np.array(at), temperature)
        for k, name in enumerate(names):
            if name.startswith("time_constant"):
                slope[:, k] /= self.values[name]
        return np.asarray(np.sqrt(np.einsum("np,pq,nq->n", slope, self.covariance, slope)), np.float64)


def fit_warmup(
    t: FloatArray, values: FloatArray, kind: WarmupKind = "exponential", temperature: FloatArray | None = None
) -> WarmupFit:
    """Least squares of `kind` to values (N,) rad/s at t (N,) s since power-on; temperature: (N,) degrees C.

    Start: all linear parameters solved for at each of a grid of time constants (variable projection), the
    best of these handed to Levenberg-Marquardt with the analytic Jacobian; time constants enter as their
    logarithms. The covariance is s^2 (J'J)^-1 for a white residual; where the residual is not white it is
    widened by what a random walk does to the parameters, of the size that the increments of the residual
    show.
    """
    names = WARMUP_PARAMETERS[kind]
    constants = _start(t, values, kind, temperature)
    basis = _basis(t, constants, kind, temperature)
    linear = np.asarray(np.linalg.lstsq(basis, values, rcond=None)[0], np.float64)
    packed = _pack(names, linear, constants)

    def residual(parameters: FloatArray) -> FloatArray:
        model = _model(names, parameters)
        made: FloatArray = model.bias(t, temperature) - values
        return made

    def jacobian(parameters: FloatArray) -> FloatArray:
        return _jacobian(t, names, parameters, temperature)

    scale = np.maximum(np.linalg.norm(jacobian(packed), axis=0), 1e-300)
    found = least_squares(
        lambda p: residual(p / scale),
        packed * scale,
        lambda p: jacobian(p / scale) / scale,
        method="lm",
        xtol=1e-12,
        ftol=1e-12,
    )
    parameters = np.asarray(found.x, float) / scale
    rest = -residual(parameters)
    count = len(t)
    noise = float(np.sqrt(rest @ rest / max(1, count - len(names))))
    covariance, widened = _covariance(t, jacobian(parameters), rest, noise)
    # From the logarithm of a time constant to the time constant itself.
    stretch = np.array(
        [
            np.exp(p) if name.startswith("time_constant") else 1.0
            for name, p in zip(names, parameters, strict=True)
        ]
    )
    covariance *= np.outer(stretch, stretch)
    model = _model(names, parameters)
    return WarmupFit(
        kind,
        model,
        {name: getattr(model, name) for name in names},
        {name: float(np.sqrt(covariance[k, k])) for k, name in enumerate(names)},
        covariance,
        rest,
        noise,
        float(count * np.log(max(float(rest @ rest) / count, 1e-300)) + len(names) * np.log(count)),
        int(found.nfev),
        widened,
    )


def _start(
    t: FloatArray, values: FloatArray, kind: WarmupKind, temperature: FloatArray | None
) -> tuple[float, ...]:
    """Time constants of the best point of the grid."""
    number = sum(name.startswith("time_constant") for name in WARMUP_PARAMETERS[kind])
    span = float(t[-1] - t[0])
    grid = np.geomspace(max(2.0 * span / len(t), span / 300.0), 10.0 * span, 24 if number == 1 else 16)
    # A few hundred means are as good for a start as all points.
    thin = max(1, len(t) // 400)
    t, values = t[::thin], values[::thin]
    temperature = None if temperature is None else temperature[::thin]
    best: tuple[float, tuple[float, ...]] = (np.inf, ())
    for constants in itertools.combinations(grid, number):
        basis = _basis(t, constants, kind, temperature)
        linear = np.linalg.lstsq(basis, values, rcond=None)[0]
        cost = float(np.sum((basis @ linear - values) ** 2))
        if cost < best[0]:
            best = cost, tuple(float(c) for c in constants)
    return best[1]


def _basis(
    t: FloatArray, constants: tuple[float, ...], kind: WarmupKind, temperature: FloatArray | None
) -> FloatArray:
    """(N, L) what the linear parameters multiply: the constant, each exponential, the temperature."""
    columns = [np.ones_like(t), *(warmup_fraction(t, constant) for constant in constants)]
    if "temperature_coefficient" in WARMUP_PARAMETERS[kind]:
        if temperature is None:
            raise ValueError(f"model {kind!r} needs the temperature")
        columns.append(temperature - REFERENCE_CELSIUS)
    return np.column_stack(columns)


def _pack(names: tuple[str, ...], linear: FloatArray, constants: tuple[float, ...]) -> FloatArray:
    left, slow = iter(linear), iter(constants)
    return np.array(
        [np.log(next(slow)) if name.startswith("time_constant") else next(left) for name in names]
    )


def _model(names: tuple[str, ...], parameters: FloatArray) -> WarmupModel:
    pairs = zip(names, parameters, strict=True)
    # Beyond e^60 s no record tells one time constant from another.
    return WarmupModel(
        **{n: float(np.exp(np.clip(p, -60, 60)) if n.startswith("time_constant") else p) for n, p in pairs}
    )


def _jacobian(
    t: FloatArray, names: tuple[str, ...], parameters: FloatArray, temperature: FloatArray | None
) -> FloatArray:
    """(N, P) derivative of the bias; with respect to the logarithm for time constants."""
    model = _model(names, parameters)
    columns = []
    for name in names:
        if name == "c2":
            columns.append(np.ones_like(t))
        elif name == "temperature_coefficient":
            assert temperature is not None
            columns.append(temperature - REFERENCE_CELSIUS)
        elif name.startswith("c1"):
            constant = getattr(model, name.replace("c1", "time_constant"))
            columns.append(warmup_fraction(t, constant))
        else:
            constant, c1 = getattr(model, name), getattr(model, name.replace("time_constant", "c1"))
            columns.append(-c1 * (t / constant) * np.exp(-t / constant))
    return np.column_stack(columns)


def _covariance(
    t: FloatArray, jacobian: FloatArray, residual: FloatArray, noise: float
) -> tuple[FloatArray, float]:
    """Covariance of the parameters, and how much wider it is than for white noise of that size.

    The latter as a ratio of variances.
    """
    inverse = np.linalg.pinv(jacobian)
    plain = noise**2 * (inverse @ inverse.T)
    if len(residual) < 4 * _PARTS or not np.ptp(residual) or ljung_box(residual).white:
        return plain, 1.0
    parts = [part.mean() for part in np.array_split(residual, _PARTS)]
    length = float(t[-1] - t[0]) / _PARTS
    white = float(np.mean(np.diff(residual) ** 2)) / 2.0
    excess = float(np.mean(np.diff(parts) ** 2)) - 2.0 * white * _PARTS / len(residual)
    walk = max(excess, 0.0) / (2.0 * length / 3.0)
    # A walk w has cov(w(s), w(t)) = K^2 min(s, t): a weighted sum of it is a sum over what still weighs after
    # t.
    tails = np.cumsum(inverse[:, ::-1], axis=1)[:, ::-1]
    steps = np.diff(t, prepend=t[0])
    wide: FloatArray = plain + walk * (tails * steps) @ tails.T
    return wide, float(np.max(np.diag(wide) / np.diag(plain)))
