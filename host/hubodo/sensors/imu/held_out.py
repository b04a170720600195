"""A calibration judged by rests and turns that took no part in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.rests import Rests
from hubodo.sensors.imu.scalar_calibration import Convention, scalar_calibration
from hubodo.sensors.imu.turns import Turns, calibrate_by_turns, turn_errors

FOLDS = 5


@dataclass(frozen=True)
class HeldOut:
    """Errors on what took no part in the fit, in folds; before: the same without calibration.

    error: (K,) accelerometer length less gravity, m/s², or angle of a turn, rad. None in ImuCalibration
    where too little is left over to hold anything out.
    """

    error: Array
    before: Array

    @property
    def rms(self) -> float:
        """Root mean square after calibration."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def rms_before(self) -> float:
        """Root mean square before calibration."""
        return float(np.sqrt(np.mean(self.before**2)))


def accel_held_out(rests: Rests, gravity: float, convention: Convention) -> HeldOut | None:
    """Each rest judged by a calibration from the other folds; None when those could not be calibrated."""
    count = len(rests)
    error = np.full(count, np.nan)
    for fold in range(FOLDS):
        out = np.arange(count) % FOLDS == fold
        fit = rests.select(~out)
        try:
            found = scalar_calibration(
                fit.accel, gravity, fit.accel_sigma, convention=convention, partial=True
            )
        except CalibrationError:
            continue
        error[out] = np.linalg.norm(found.triad.apply(rests.accel[out]), axis=1) - gravity
    known = np.isfinite(error)
    if not known.any():
        return None
    return HeldOut(error[known], np.linalg.norm(rests.accel, axis=1)[known] - gravity)


def turns_held_out(turns: Turns, bias_sigma: Array) -> HeldOut | None:
    """Each turn judged by gyros calibrated with the other folds; None when those could not be."""
    error = np.full(len(turns.dt), np.nan)
    for fold in range(FOLDS):
        out = np.arange(len(error)) % FOLDS == fold
        try:
            found = calibrate_by_turns(turns.select(~out), bias_sigma)
        except CalibrationError:
            continue
        error[out] = turn_errors(turns.select(out), found.matrix, found.bias_change)
    known = np.isfinite(error)
    if not known.any():
        return None
    return HeldOut(error[known], turn_errors(turns, np.eye(3))[known])
