"""Cross-validation of an IMU calibration on standstills and turns that were not fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.scalar_calibration import Convention, fit_scalar_calibration
from hubodo.sensors.imu.standstills import Standstills
from hubodo.sensors.imu.turn_calibration import calibrate_from_turns
from hubodo.sensors.imu.turns import Turns, turn_errors

FOLD_COUNT = 5
_MAX_LEAVE_ONE_OUT = 30
"""Poses up to which each is a fold: four fifths of twelve poses hardly determine nine parameters."""


@dataclass(frozen=True)
class CrossValidation:
    """Cross-validation errors.

    Attributes:
        index: (K,) index of each standstill or turn.
        error: (K,) norm of the accelerometer minus gravity, m/s², or angle error of a turn, rad.
        error_before: (K,) the same without calibration.
    """

    index: NDArray[np.int64]
    error: Array
    error_before: Array

    @property
    def rms(self) -> float:
        """Return the root mean square error after calibration."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def rms_before(self) -> float:
        """Return the root mean square error before calibration."""
        return float(np.sqrt(np.mean(self.error_before**2)))


def cross_validate_accel(
    standstills: Standstills, gravity: float, convention: Convention, exponents: tuple[int, ...] = ()
) -> CrossValidation | None:
    """Return the errors of each standstill under the calibration of the other folds; None if those fail."""
    count = len(standstills)
    error = np.full(count, np.nan)
    folds = count if count <= _MAX_LEAVE_ONE_OUT else FOLD_COUNT
    for fold in range(folds):
        held = np.arange(count) % folds == fold
        training = standstills.select(~held)
        try:
            calibration = fit_scalar_calibration(
                training.accel,
                gravity,
                training.accel_sigma,
                convention=convention,
                allow_partial=True,
                exponents=exponents,
            )
        except CalibrationError:
            continue
        error[held] = np.linalg.norm(calibration.correct(standstills.accel[held]), axis=1) - gravity
    finite = np.isfinite(error)
    if not finite.any():
        return None
    before = np.linalg.norm(standstills.accel, axis=1) - gravity
    return CrossValidation(np.flatnonzero(finite), error[finite], before[finite])


def cross_validate_turns(turns: Turns, bias_sigma: Array) -> CrossValidation | None:
    """Return the errors of each turn under the calibration of the other folds, or None if those fail."""
    error = np.full(len(turns.dt), np.nan)
    for fold in range(FOLD_COUNT):
        held = np.arange(len(error)) % FOLD_COUNT == fold
        try:
            calibration = calibrate_from_turns(turns.select(~held), bias_sigma)
        except CalibrationError:
            continue
        error[held] = turn_errors(
            turns.select(held),
            calibration.matrix,
            calibration.bias_change,
            np.append(calibration.earth_rate, calibration.terms),
        )
    finite = np.isfinite(error)
    if not finite.any():
        return None
    return CrossValidation(turns.number[finite], error[finite], turn_errors(turns, np.eye(3))[finite])
