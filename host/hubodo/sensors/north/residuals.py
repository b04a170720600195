"""Residuals of the north estimate, for plots and whiteness checks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cholesky, solve_triangular

from hubodo.arrays import Array
from hubodo.sensors.north.drift import drift_covariance
from hubodo.sensors.north.north_estimate import NorthEstimate
from hubodo.sensors.north.whitening import temperature_column


@dataclass(frozen=True)
class NorthResiduals:
    """Residuals of the M averages of all records, in order.

    Attributes:
        t: (M,) centre of each interval, s.
        earth: (M,) measured rate without bias and ramp, rad/s.
        model: (M,) modelled Earth rate, rad/s.
        angle: (M,) angle of the sensing axis, rad.
        residual: (M,) earth - model, including the drift, rad/s.
        rate: (M,) measured rate without Earth rate, rad/s: bias and drift.
        temperature: (M,) °C, NaN where unknown.
        whitened: (M,) residual whitened by the covariance of noise and drift; unit variance if the model
            holds.
    """

    t: Array
    earth: Array
    model: Array
    angle: Array
    residual: Array
    whitened: Array
    rate: Array
    temperature: Array


def compute_residuals(estimate: NorthEstimate) -> NorthResiduals:
    """Return the residuals at the estimated azimuth and drift."""
    rows = []
    north = estimate.horizontal_rate * np.array([np.cos(estimate.azimuth), np.sin(estimate.azimuth)])
    for averages in estimate.averages:
        cos, sin, _, _, y = averages.design_columns(0.0).T
        noise_covariance = drift_covariance(estimate.posterior.drift, averages.start, averages.end)
        factor = cholesky(noise_covariance, lower=True)
        middle = (averages.start + averages.end) / 2
        model = np.column_stack([cos, sin]) @ north
        ramp = (middle - middle.mean()) / max(float(np.ptp(middle)), 1e-9)
        polynomial = legvander(2 * ramp, estimate.posterior.order)
        if estimate.posterior.uses_temperature:
            polynomial = np.column_stack([polynomial, temperature_column(averages)])
        whitened_columns = solve_triangular(factor, np.column_stack([polynomial, y - model]), lower=True)
        coefficients = np.linalg.lstsq(whitened_columns[:, :-1], whitened_columns[:, -1], rcond=None)[0]
        earth = y - polynomial @ coefficients
        whitened = whitened_columns[:, -1] - whitened_columns[:, :-1] @ coefficients
        degrees = np.full(len(y), np.nan) if averages.temperature is None else averages.temperature
        angle = np.arctan2(sin, cos)
        rows.append(np.stack([middle, earth, model, angle, earth - model, whitened, y - model, degrees]))
    return NorthResiduals(*np.concatenate(rows, axis=1))
