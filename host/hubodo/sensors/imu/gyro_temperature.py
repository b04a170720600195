"""Gyro bias against temperature in standstills: a polynomial of selected order, and its hysteresis.

A bias at the mean temperature of the poses is known best, so the polynomial is subtracted about that
temperature while scale and cross-axis terms are estimated. At the end the bias is stated at 25 °C, with the
uncertainty of this extrapolation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.sensors.imu.pose_temperature import (
    MAX_ORDER,
    MAX_P_VALUE,
    PoseTemperature,
    powers_of,
    select_model,
)

_MAX_CORRELATION = 0.9
_MIN_HYSTERESIS_POSES = 3
"""Poses while it becomes warmer, and while it becomes colder, that a test of hysteresis needs."""


@dataclass(frozen=True)
class GyroPolynomial:
    """The biases of C gyros as polynomials of the temperature.

    Attributes:
        coefficients: (order, C) of the powers of the difference from 25 °C, rad/s/°C^n.
        covariance: (C, order, order) of the coefficients of each gyro.
        mean_powers: (order,) means of the powers over the poses.
        mean_covariance: (C, order) covariance of the mean bias with the coefficients.
        hysteresis: (C,) half the difference between warming and cooling, rad/s, if significant.
        temperature, rate: (R,) and (R, C) of the poses, °C and rad/s.
        dof: degrees of freedom of the residual.
    """

    coefficients: Array
    covariance: Array
    mean_powers: Array
    mean_covariance: Array
    hysteresis: Array | None
    temperature: Array
    rate: Array
    dof: int

    @property
    def order(self) -> int:
        """Return the order of the polynomial."""
        return len(self.coefficients)

    def change(self, temperature: Array) -> Array:
        """Return the (N, C) change of the bias from its mean over the poses, at temperatures (N,)."""
        return np.asarray((powers_of(temperature, self.order) - self.mean_powers) @ self.coefficients)

    def bias_at_reference(self, bias: Array, covariance: Array) -> tuple[Array, Array]:
        """Return the bias at 25 °C and its covariance from the mean bias (C,) and its covariance (C, C)."""
        at_reference = bias + self.change(np.array([REFERENCE_CELSIUS]))[0]
        slope = -self.mean_powers
        variance = np.einsum("n,cnm,m->c", slope, self.covariance, slope) + 2.0 * self.mean_covariance @ slope
        spread = np.zeros(len(bias)) if self.hysteresis is None else self.hysteresis**2
        # The mean was estimated as if the polynomial were known.
        lost = np.diag(covariance) * self.order / max(self.dof, 1)
        return at_reference, covariance + np.diag(np.maximum(variance, 0.0) + spread + lost)


def fit_gyro_polynomial(
    rate: Array, sigma: Array, temperatures: PoseTemperature, order: int | None = None
) -> GyroPolynomial | None:
    """Return the polynomials of standstill rates (R, C), rad/s, or None if no order is significant.

    sigma: (R, C) standard errors. order: stated order, 0 for none; None selects it.
    """
    weight = 1.0 / np.sqrt((sigma**2).mean(axis=0) + 1e-300)

    def fit(model: tuple[int, ...]) -> tuple[int, float, float, float]:
        design = np.column_stack([np.ones(len(rate)), temperatures.powers(model[0])])
        q = np.linalg.qr(design)[0]
        residual = (rate - q @ (q.T @ rate)) * weight
        left_out = residual / np.maximum(1.0 - (q**2).sum(axis=1), 1e-9)[:, None]
        dof = rate.shape[1] * (len(rate) - design.shape[1])
        return model[0], float((residual**2).sum()), float(dof), float((left_out**2).sum())

    def further(model: tuple[int, ...]) -> list[tuple[int, ...]]:
        return [(n,) for n in range(model[0] + 1, MAX_ORDER + 1)]

    chosen = select_model(fit, (0,), further, rate.shape[1])[0] if order is None else order
    return _fit(rate, sigma, temperatures, chosen) if chosen else None


def _fit(rate: Array, sigma: Array, temperatures: PoseTemperature, order: int) -> GyroPolynomial:
    powers = temperatures.powers(order)
    mean_powers = powers.mean(axis=0)
    design = np.column_stack([np.ones(len(rate)), powers - mean_powers])
    hysteresis = _test_hysteresis(design, rate, temperatures)
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ rate
    residual = rate - design @ coefficients
    dof = len(rate) - design.shape[1]
    scatter = (residual**2).sum(axis=0) / max(dof, 1) * _correlation_factor(residual)
    # Few poses estimate the scatter, hence the variance of Student's t distribution.
    variance = np.maximum(scatter * dof / max(dof - 2, 1), (sigma**2).mean(axis=0))
    unit = inverse @ inverse.T
    covariance = variance[:, None, None] * unit
    return GyroPolynomial(
        coefficients[1:],
        covariance[:, 1:, 1:],
        mean_powers,
        covariance[:, 0, 1:],
        hysteresis,
        temperatures.poses,
        rate,
        dof,
    )


def _correlation_factor(residual: Array) -> Array:
    """Return the (C,) factors by which a drift in time, common to neighbouring poses, widens variances."""
    product = (residual[1:] * residual[:-1]).sum(axis=0)
    r = np.clip(product / np.maximum((residual**2).sum(axis=0), 1e-300), 0.0, _MAX_CORRELATION)
    chance = 2.0 / np.sqrt(len(residual))
    r = np.where(r > chance, r, 0.0)
    return np.asarray((1.0 + r) / (1.0 - r))


def _test_hysteresis(design: Array, rate: Array, temperatures: PoseTemperature) -> Array | None:
    """Return half the difference of the rates between warming and cooling, (C,), if it is significant."""
    direction = np.sign(temperatures.rates)
    dof = len(rate) - design.shape[1] - 1
    if dof < 3 or min((direction > 0).sum(), (direction < 0).sum()) < _MIN_HYSTERESIS_POSES:
        return None
    extended = np.column_stack([design, direction])
    misfits = []
    for columns in (design, extended):
        solution = np.linalg.lstsq(columns, rate, rcond=None)[0]
        misfits.append(((rate - columns @ solution) ** 2).sum(axis=0))
    ratio = (misfits[0] - misfits[1]) / np.maximum(misfits[1], 1e-300) * dof
    p_value = fdtrc(1, dof, np.maximum(ratio, 0.0)) * rate.shape[1]
    if (p_value > MAX_P_VALUE).all():
        return None
    return np.asarray(np.where(p_value <= MAX_P_VALUE, np.abs(solution[-1]), 0.0))
