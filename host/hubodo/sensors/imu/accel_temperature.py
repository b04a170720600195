"""Accelerometer bias and scale against temperature, from the length of gravity in warm and cold poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.pose_temperature import MAX_ORDER, PoseTemperature, powers_of, select_model
from hubodo.sensors.imu.scalar_calibration import PoseTerm, ScalarCalibration, fit_scalar_calibration
from hubodo.sensors.imu.standstills import Standstills

_FOLDS = 5
_REFIT_COUNT = 2
_NINE_PARAMETERS = 9


@dataclass(frozen=True)
class AccelTemperatureModel:
    """Polynomials of the three biases, and linear changes of the scales, about 25 °C.

    Attributes:
        coefficients: (T, 3) of each pose term, in units of gravity.
        order: order of the polynomials of the biases.
        has_scale: True if the last row of `coefficients` is the change of the scales, 1/°C.
        gravity: m/s².
    """

    coefficients: Array
    order: int
    has_scale: bool
    gravity: float

    def remove(self, accel: Array, temperature: Array) -> Array:
        """Return readings (N, 3) at temperatures (N,) as they would be at 25 °C, m/s²."""
        bias = self.gravity * powers_of(temperature, self.order) @ self.coefficients[: self.order]
        scale = np.zeros(3)
        if self.has_scale:
            scale = (temperature - REFERENCE_CELSIUS)[:, None] * self.coefficients[-1]
        return np.asarray((accel - bias) / (1.0 + scale))

    def terms(self, temperatures: PoseTemperature) -> tuple[PoseTerm, ...]:
        """Return the terms of a fit to poses."""
        return _pose_terms(self.order, self.has_scale, temperatures)

    def add(self, coefficients: Array) -> AccelTemperatureModel:
        """Return the model with the coefficients (T, 3) of a fit to corrected readings added."""
        return AccelTemperatureModel(
            self.coefficients + coefficients, self.order, self.has_scale, self.gravity
        )


def fit_accel_temperature(
    standstills: Standstills, temperatures: PoseTemperature, gravity: float, order: int | None = None
) -> AccelTemperatureModel | None:
    """Return the terms of the temperature that the poses show, or None if none is significant.

    order: stated order of the biases, 0 for no terms; None selects it. The scale is tested in both cases.
    """

    def fit(model: tuple[int, ...]) -> tuple[ScalarCalibration, float, float, float]:
        terms = _pose_terms(model[0], bool(model[1]), temperatures)
        dof = len(standstills) - _NINE_PARAMETERS - 3 * len(terms)
        calibration = _fit(standstills, terms, gravity)
        if not calibration.is_observable.all():
            return calibration, np.inf, 0.0, np.inf
        held_out = _held_out_error(standstills, model, temperatures, gravity)
        return calibration, (calibration.reduced_chi2 or 0.0) * dof, dof, held_out

    def further(model: tuple[int, ...]) -> list[tuple[int, ...]]:
        largest = MAX_ORDER if order is None else order
        trials: list[tuple[int, ...]] = [(n, model[1]) for n in range(model[0] + 1, largest + 1)]
        return trials if model[1] else [*trials, (model[0], 1)]

    if order == 0:
        return None
    chosen = select_model(fit, (order or 0, 0), further, 3)[1]
    if not any(chosen):
        return None
    count = chosen[0] + chosen[1]
    model = AccelTemperatureModel(np.zeros((count, 3)), chosen[0], bool(chosen[1]), gravity)
    for _ in range(_REFIT_COUNT):
        corrected = model.remove(standstills.accel, temperatures.poses)
        model = model.add(_fit(standstills, model.terms(temperatures), gravity, corrected).pose_terms)
    return model


def _fit(
    standstills: Standstills, terms: tuple[PoseTerm, ...], gravity: float, accel: Array | None = None
) -> ScalarCalibration:
    values = standstills.accel if accel is None else accel
    return fit_scalar_calibration(
        values, gravity, standstills.accel_sigma, allow_partial=True, pose_terms=terms
    )


def _pose_terms(order: int, has_scale: bool, temperatures: PoseTemperature) -> tuple[PoseTerm, ...]:
    powers = temperatures.powers(max(order, 1)).T
    scale = (PoseTerm(1, powers[0]),) if has_scale else ()
    return (*(PoseTerm(0, powers[n]) for n in range(order)), *scale)


def _held_out_error(
    standstills: Standstills, model: tuple[int, ...], temperatures: PoseTemperature, gravity: float
) -> float:
    """Return the squared error of the length of gravity in poses that were not fitted, (m/s²)²."""
    total, index = 0.0, np.arange(len(standstills))
    for fold in range(_FOLDS):
        held: NDArray[np.bool_] = index % _FOLDS == fold
        known = temperatures.select(~held)
        terms = _pose_terms(model[0], bool(model[1]), known)
        try:
            calibration = _fit(standstills.select(~held), terms, gravity)
        except CalibrationError:
            return np.inf
        fitted = AccelTemperatureModel(calibration.pose_terms, model[0], bool(model[1]), gravity)
        corrected = fitted.remove(standstills.accel[held], temperatures.poses[held])
        total += float(((np.linalg.norm(calibration.correct(corrected), axis=1) - gravity) ** 2).sum())
    return total
