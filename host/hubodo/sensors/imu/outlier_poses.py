"""Detection of static poses that contradict the others in the length of gravity, such as a knocked one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, fdtrc

from hubodo.errors import CalibrationError
from hubodo.sensors.imu.scalar_calibration import ScalarCalibration, fit_scalar_calibration
from hubodo.sensors.imu.standstills import Standstills

_PARAMETERS = 9
_MIN_DOF = 3
"""Redundant poses that remain without the outlier: fewer do not show which pose it is."""
_MAX_MISFIT_P_VALUE = 1e-3
_MAX_OUTLIER_P_VALUE = 1e-4
"""Probability of a false alarm in a record, for normal errors of any size."""
_MAX_OUTLIER_FRACTION = 0.15


def drop_outlier_poses(standstills: Standstills, gravity: float) -> Standstills:
    """Return the standstills without those that contradict the others; `rejected` has a line for each.

    One pose is dropped at a time, if the calibration without it fits significantly better (F-test of its
    deleted residual, corrected for the number of poses).
    """
    limit = int(_MAX_OUTLIER_FRACTION * len(standstills))
    for _ in range(limit):
        misfit, dof = _misfit(standstills, gravity)
        if dof <= _MIN_DOF or chdtrc(dof, misfit) > _MAX_MISFIT_P_VALUE:
            break
        indices = np.arange(len(standstills))
        without = np.array([_misfit(standstills.select(indices != k), gravity)[0] for k in indices])
        worst = int(np.argmin(without))
        ratio = (misfit - without[worst]) * (dof - 1) / max(without[worst], 1e-300)
        if fdtrc(1, dof - 1, max(ratio, 0.0)) * len(indices) > _MAX_OUTLIER_P_VALUE:
            break
        line = _describe(standstills, worst, gravity)
        standstills = standstills.select(indices != worst)
        standstills = replace(standstills, rejected=(*standstills.rejected, line))
    return standstills


def _fit(standstills: Standstills, gravity: float) -> ScalarCalibration:
    return fit_scalar_calibration(standstills.accel, gravity, standstills.accel_sigma, allow_partial=True)


def _misfit(standstills: Standstills, gravity: float) -> tuple[float, int]:
    """Return the chi-square of the norms and its degrees of freedom; infinite if the fit fails."""
    try:
        fit = _fit(standstills, gravity)
    except CalibrationError:
        return np.inf, 0
    if fit.reduced_chi2 is None or not fit.is_observable.all():
        return np.inf, 0
    dof = len(standstills) - _PARAMETERS
    return fit.reduced_chi2 * dof, dof


def _describe(standstills: Standstills, worst: int, gravity: float) -> str:
    others = np.arange(len(standstills)) != worst
    triad = _fit(standstills.select(others), gravity).triad
    error = float(np.linalg.norm(triad.correct(standstills.accel[worst]))) - gravity
    return (
        f"{standstills.name(worst)} rejected: gravity is {error:+.3g} m/s² "
        f"({error / gravity * 1e3:+.2g} mg) off the calibration by the other poses; it was knocked or held "
        "by hand"
    )
