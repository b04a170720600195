"""Test for nonlinear terms of accelerometers and gyros beside bias, scale and cross-axis terms.

A term that the model lacks moves bias and scale by more than their sigma. Families of terms are added one at
a time, if the F-test of the misfit is significant; bias and scale are then estimated beside them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from scipy.special import fdtrc

from hubodo.errors import CalibrationError
from hubodo.sensors.imu.scalar_calibration import (
    Convention,
    PoseTerm,
    ScalarCalibration,
    fit_scalar_calibration,
)
from hubodo.sensors.imu.standstills import Standstills

MAX_P_VALUE = 0.01
"""Largest p-value, corrected for the number of families, at which a family of terms is included."""
MAX_SCATTER = 3.0
"""Misfit relative to the noise of the standstills above which it is reported."""
MIN_DOF = 3
"""Degrees of freedom that remain beside all terms."""
_TERMS = 3
"""Terms of a family, one for each axis."""
_ACCEL_EXPONENTS = (2, 3)
_POWER_NAMES = {2: "quadratic", 3: "cubic"}

Fit = TypeVar("Fit")


def select_terms(
    fit: Callable[[tuple[int, ...]], tuple[Fit, float, float]], families: tuple[int, ...]
) -> tuple[Fit, tuple[int, ...]]:
    """Return the fit with the families of terms that are significant, and these families.

    fit: returns a fit with the given families, its misfit and degrees of freedom; raises CalibrationError if
    it fails.
    """
    chosen: tuple[int, ...] = ()
    best, misfit, _ = fit(chosen)
    while len(chosen) < len(families):
        trials = []
        for family in set(families) - set(chosen):
            trial = tuple(sorted((*chosen, family)))
            try:
                result, smaller, dof = fit(trial)
            except (CalibrationError, np.linalg.LinAlgError):
                continue
            if dof < MIN_DOF:
                continue
            ratio = (misfit - smaller) / _TERMS * dof / max(smaller, 1e-300)
            trials.append((float(fdtrc(_TERMS, dof, max(ratio, 0.0))), trial, result, smaller))
        if not trials:
            break
        p_value, trial, result, smaller = min(trials, key=lambda it: (it[0], it[3]))
        if p_value * len(families) > MAX_P_VALUE:
            break
        chosen, best, misfit = trial, result, smaller
    return best, chosen


def fit_accelerometers(
    standstills: Standstills, gravity: float, convention: Convention, pose_terms: tuple[PoseTerm, ...] = ()
) -> ScalarCalibration:
    """Return the scalar calibration of the accelerometers, beside nonlinear terms if they are significant.

    pose_terms: further terms, estimated beside them.
    """

    def fit(exponents: tuple[int, ...]) -> tuple[ScalarCalibration, float, float]:
        calibration = fit_scalar_calibration(
            standstills.accel,
            gravity,
            standstills.accel_sigma,
            convention=convention,
            allow_partial=True,
            exponents=exponents,
            pose_terms=pose_terms,
        )
        if not calibration.is_observable.all():
            return calibration, np.inf, 0.0
        dof = len(standstills) - 9 - 3 * len((*exponents, *pose_terms))
        return calibration, (calibration.reduced_chi2 or 0.0) * dof, dof

    return select_terms(fit, _ACCEL_EXPONENTS)[0]


def describe_accelerometers(calibration: ScalarCalibration) -> list[str]:
    """Return lines on nonlinear terms of the accelerometers, in mg at 1 g, and on an unexplained misfit."""
    terms, sigmas = (values.reshape(-1, 3) for values in (calibration.nonlinear, calibration.nonlinear_sigma))
    lines = [
        f"the accelerometers are nonlinear: {_POWER_NAMES[n]} terms "
        + ", ".join(
            f"{axis} {1e3 * k:+.2g} ± {1e3 * s:.1g} mg" for axis, k, s in zip("xyz", row, sigma, strict=True)
        )
        + " at 1 g; bias and scale are estimated beside them, but calibration files have no such terms"
        for n, row, sigma in zip(calibration.exponents, terms, sigmas, strict=True)
    ]
    ratio = np.sqrt(calibration.reduced_chi2 or 0.0)
    if ratio > MAX_SCATTER:
        lines.append(
            f"the length of gravity scatters {ratio:.2g} times as much as the noise of the standstills, and "
            "sigmas are widened accordingly: the biases drift, or the sensor has an error that is not "
            "modelled; let it warm up, and repeat poses"
        )
    return lines
