"""Calibration of axes whose true value is known in each pose: multi-position test on a dividing head.

Axis i reads y = b_i + sum over j of M_ij f_j, linear in bias b and the row of M, with the reference f. With
references of all three axes the row has scale and two cross-axis terms, with that of its own axis the scale
alone. Factory tolerances are the prior, as in the scalar method.

References
----------
IEEE Std 1293-2018, multi-position tumble test of accelerometers; IEEE Std 1554-2005, of inertial sensors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu.pose_observability import MAX_OBSERVABLE_SIGMA, FactoryTolerance
from hubodo.sensors.imu.result import TriadCalibration

_FACTORY_TOLERANCE = FactoryTolerance(bias=1.0)
_MIN_DOF = 3
_MAX_CHANCE = 0.01
_SCALE_RANGE = (0.7, 1.4)
"""Ratios of reading to reference beyond which the unit or the sign is wrong: no sensor is that inaccurate."""


def fit_known_references(
    mean: Array, reference: Array, sigma: Array, weight: Array, name: str
) -> TriadCalibration:
    """Return the calibration of the axes that have a mean and a reference in each pose.

    mean, reference: (R, 3), NaN where missing. sigma: (R, 3) standard errors of the means, NaN if unknown;
    they then follow from the misfit. weight: (R,) relative precision of the poses. name: gyro or accel.
    Raises CalibrationError if the poses do not determine bias and scale of each axis, InputError for another
    unit or a reversed axis.
    """
    axes = np.asarray(np.isfinite(mean).all(axis=0) & np.isfinite(reference).all(axis=0))
    triad_bias, matrix = np.zeros(3), np.eye(3)
    covariance, is_observable = np.zeros((12, 12)), np.zeros((3, 3), bool)
    given = [int(j) for j in np.flatnonzero(np.isfinite(reference).all(axis=0))]
    scale = float(np.abs(reference[:, given]).max())
    for i in np.flatnonzero(axes):
        used = given if len(given) == 3 else [int(i)]
        value, own, shown = _fit_axis(
            mean[:, i] / scale, reference[:, used] / scale, sigma[:, i] / scale, weight, used.index(int(i)),
            f"{name} {'xyz'[i]}",
        )  # fmt: skip
        triad_bias[i], matrix[i, used] = value[0] * scale, value[1:]
        index = [int(i), *(3 + 3 * int(i) + j for j in used)]
        units = np.array([scale] + [1.0] * len(used))
        covariance[np.ix_(index, index)] = own * np.outer(units, units)
        is_observable[i, used] = shown
    what = (
        "bias, scale and cross-axis terms"
        if len(given) == 3
        else "bias and scale, cross-axis terms taken as zero,"
    )
    names = ", ".join("xyz"[i] for i in np.flatnonzero(axes))
    return TriadCalibration(
        Triad(triad_bias, matrix),
        covariance,
        is_observable.ravel(),
        f"{what} of {name} {names} from the references of {len(mean)} poses",
        axes=axes,
    )


def _fit_axis(
    y: Array, f: Array, sigma: Array, weight: Array, own: int, name: str
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return b and the row of M, their covariance, and which elements of the row were determined."""
    design = np.column_stack([np.ones(len(y)), f])
    if np.ptp(f[:, own]) < 0.1:
        raise CalibrationError(
            f"the references of {name} hardly differ: bias and scale need poses with the axis up and down"
        )
    slope = float(np.linalg.lstsq(design, y, rcond=None)[0][1 + own])
    if not _SCALE_RANGE[0] < slope < _SCALE_RANGE[1]:
        raise InputError(
            f"{name} reads {slope:.3g} times its reference, in another unit or with another sign; "
            "write units in the headings, as in ref_ax (g)"
        )
    dof = len(y) - design.shape[1]
    prior = np.array([_FACTORY_TOLERANCE.bias] + [_FACTORY_TOLERANCE.scale_and_angle] * f.shape[1])
    known = bool(np.isfinite(sigma).all())
    noise = sigma if known else _noise_of_misfit(design, y, prior, own, weight, name)
    p, covariance = _solve(design, y, noise, prior, own)
    misfit = float((((y - design @ p) / noise) ** 2).sum())
    if known and dof >= _MIN_DOF and chdtrc(dof, misfit) < _MAX_CHANCE:
        _, covariance = _solve(design, y, noise * np.sqrt(misfit / (dof - 2)), prior, own)
    is_observable = np.asarray(np.sqrt(np.diag(covariance))[1:] <= MAX_OBSERVABLE_SIGMA)
    if not is_observable[own]:
        raise CalibrationError(
            f"the poses do not determine the scale of {name}: average longer, in more poses"
        )
    return p, covariance, is_observable


def _noise_of_misfit(design: Array, y: Array, prior: Array, own: int, weight: Array, name: str) -> Array:
    """Return the (R,) standard errors estimated from the misfit, widened by Student's t distribution."""
    dof = len(y) - design.shape[1]
    if dof < _MIN_DOF:
        raise CalibrationError(
            f"{len(y)} poses of {name} leave {max(dof, 0)} degrees of freedom for their noise, of {_MIN_DOF} "
            "needed: give --mean-sigma, a column sigma_ or std_ and count, or more poses"
        )
    noise = 1.0 / np.sqrt(weight)
    for _ in range(3):
        p, _ = _solve(design, y, noise, prior, own)
        noise = noise * max(float(np.sqrt((((y - design @ p) / noise) ** 2).sum() / (dof - 2))), 1e-9)
    return np.asarray(noise)


def _solve(design: Array, y: Array, noise: Array, prior: Array, own: int) -> tuple[Array, Array]:
    """Return the parameters and their covariance; scale errors and angles are zero a priori."""
    centre = np.zeros(design.shape[1])
    centre[1 + own] = 1.0
    rows = design / noise[:, None]
    covariance = np.linalg.inv(rows.T @ rows + np.diag(prior**-2))
    return covariance @ (rows.T @ (y / noise) + centre * prior**-2), np.asarray(covariance)
