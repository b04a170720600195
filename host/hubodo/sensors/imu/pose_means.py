"""Calibration from means of static poses instead of a record: by known references, or by gravity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.earth import EARTH_RATE
from hubodo.errors import CalibrationError, InputError
from hubodo.log.number_recording import IMU_CHANNELS
from hubodo.log.pose_table import PoseTable
from hubodo.sensors.imu.accel_poses import calibrate_accelerometers
from hubodo.sensors.imu.calibrate import (
    check_place,
    estimate_static_bias,
    try_earth_rate,
)
from hubodo.sensors.imu.known_references import fit_known_references
from hubodo.sensors.imu.node_imu import ImuOptions, measured_triad
from hubodo.sensors.imu.outlier_poses import drop_outlier_poses
from hubodo.sensors.imu.quantisation import find_quantisation_steps
from hubodo.sensors.imu.result import ImuCalibration, TriadCalibration
from hubodo.sensors.imu.scalar_calibration import fit_scalar_calibration
from hubodo.sensors.imu.standstills import Standstills

DEFAULT_NODE = "imu"
"""Name of the node of a table, which names none."""
_GYRO, _ACCEL = slice(0, 3), slice(3, 6)
_MIN_DOF = 3
_FIRST_SIGMA = 1e-3
"""Relative noise at which the estimate of the noise begins."""
_OUTLIER_TEST_FACTOR = 10.0
_REFERENCE_TOLERANCE = 0.02
"""Relative error of a reference beyond which it is not gravity in m/s²."""


def calibrate_pose_means(
    table: PoseTable, node: str, source: str, options: ImuOptions, mean_sigma: Mapping[str, float]
) -> ImuCalibration:
    """Calibrate the triads or axes of a table of pose means.

    source: name for errors. mean_sigma: standard error of the means of each channel, SI, if stated. Axes with
    references are calibrated by them, an accelerometer triad without by gravity, a gyro triad without by
    Earth rate, or its bias alone. Raises InputError for doubtful units or a single axis without reference,
    CalibrationError if the poses do not suffice.
    """
    check_place(options.gravity, options.latitude)
    sigma, weight = _standard_errors(table, mean_sigma)
    notes: list[str] = []
    result = ImuCalibration(None, options.gravity, None, None, None, (), node)
    if np.isfinite(table.reference[:, _ACCEL]).any():
        _check_reference(table.reference[:, _ACCEL], options.gravity, source)
        accel = fit_known_references(
            table.mean[:, _ACCEL], table.reference[:, _ACCEL], sigma[:, _ACCEL], weight, "accel"
        )
        notes.append(f"accelerometers: {accel.method}")
        result = replace(result, referenced_accel=accel)
    else:
        poses = _pose_standstills(table, sigma, weight, options.gravity, source)
        if poses is not None:
            used = calibrate_accelerometers(poses, options.gravity, options.convention)
            notes = used.notes
            result = replace(
                result, standstills=used.standstills, accel=used.accel, accel_held_out=used.held_out
            )
    gyro = _calibrate_gyro(table, sigma, weight, result, options, source, notes)
    if gyro is not None:
        notes.insert(min(1, len(notes)), f"gyros: {gyro.method}")
    if gyro is None and result.accel is None and result.referenced_accel is None:
        raise InputError(f"{source}: has neither gyro nor accelerometer")
    return replace(result, gyro=gyro, notes=tuple(notes))


def _standard_errors(table: PoseTable, mean_sigma: Mapping[str, float]) -> tuple[Array, Array]:
    """Return the (R, 6) standard errors of the means, NaN if unknown, and the (R,) relative precisions."""
    count = table.count if np.isfinite(table.count).all() and (table.count > 0).all() else None
    sigma = np.broadcast_to(table.sigma, table.mean.shape).copy()
    if count is not None:
        sigma = np.where(np.isfinite(sigma), sigma, table.std / np.sqrt(count)[:, None])
    for index, channel in enumerate(IMU_CHANNELS):
        if channel in mean_sigma:
            sigma[:, index] = mean_sigma[channel]
    rounding = find_quantisation_steps(np.nan_to_num(table.mean)) / np.sqrt(12)
    weight = np.ones(len(table.mean)) if count is None else count / count.mean()
    return np.hypot(sigma, rounding), weight


def _check_reference(reference: Array, gravity: float, source: str) -> None:
    """Raise InputError if references of the accelerometer are longer than gravity, or another unit."""
    length = np.sqrt(np.nansum(reference**2, axis=1))
    is_complete = bool(np.isfinite(reference).all())
    worst = int(np.argmax(np.abs(length / gravity - 1.0))) if is_complete else int(np.argmax(length))
    ratio = length[worst] / gravity
    if abs(ratio - 1.0) > _REFERENCE_TOLERANCE if is_complete else ratio > 1.0 + _REFERENCE_TOLERANCE:
        raise InputError(
            f"{source}: the reference of pose {worst + 1} is {length[worst]:.4g} m/s² where gravity is "
            f"{gravity:.4g}: write its unit in the heading, as in ref_ax (g), or correct --gravity"
        )


def _pose_standstills(
    table: PoseTable, sigma: Array, weight: Array, gravity: float, source: str
) -> Standstills | None:
    """Return the poses of an accelerometer triad as standstills, or None if it was not measured."""
    accel = measured_triad(
        table.mean[:, _ACCEL], source, "accelerometer", "give the true values in a column such as ref_az"
    )
    if not accel.shape[1]:
        return None
    noise = sigma[:, _ACCEL]
    is_known = bool(np.isfinite(noise).all())
    if not is_known:
        # The misfit includes a contradictory pose; the F-test that detects it does not depend on the noise.
        noise = _noise_of_misfit(accel, weight, gravity) / _OUTLIER_TEST_FACTOR
    rows, times = np.arange(len(accel)), np.full((len(accel), 2), np.nan)
    gyro, gyro_sigma = table.mean[:, _GYRO], sigma[:, _GYRO]
    poses = Standstills(rows, rows + 1, times, gyro, accel, gyro_sigma, noise, are_means=True)
    if is_known:
        return poses
    poses = drop_outlier_poses(poses, gravity)
    return replace(poses, accel_sigma=_noise_of_misfit(poses.accel, weight[poses.start], gravity))


def _noise_of_misfit(accel: Array, weight: Array, gravity: float) -> Array:
    """Return the (R, 3) standard errors from the misfit of redundant poses.

    They are widened by Student's t distribution, as the noise level is an estimate.
    """
    dof = len(accel) - 9
    if dof < _MIN_DOF:
        raise CalibrationError(
            f"{len(accel)} poses do not show the noise of their means, {9 + _MIN_DOF} are needed: give "
            "--mean-sigma, columns sigma_ax, sigma_ay, sigma_az, or std_ax, std_ay, std_az and count"
        )
    noise = np.repeat(_FIRST_SIGMA * gravity / np.sqrt(weight)[:, None], 3, axis=1)
    for _ in range(5):
        chi2 = fit_scalar_calibration(accel, gravity, noise, allow_partial=True).reduced_chi2
        if chi2 is None:
            raise CalibrationError(
                "the poses repeat each other and do not show their noise: give --mean-sigma"
            )
        noise = noise * max(np.sqrt(chi2 * dof / (dof - 2)), 1e-6)
    return noise


def _calibrate_gyro(
    table: PoseTable,
    sigma: Array,
    weight: Array,
    result: ImuCalibration,
    options: ImuOptions,
    source: str,
    notes: list[str],
) -> TriadCalibration | None:
    """Return the calibration of the gyro, or None if it was not measured."""
    mean, reference = table.mean[:, _GYRO], table.reference[:, _GYRO]
    if np.isfinite(reference).any():
        return fit_known_references(mean, reference, sigma[:, _GYRO], weight, "gyro")
    gyro = measured_triad(mean, source, "gyro", "give the true rates in a column such as ref_gz")
    if not gyro.shape[1]:
        return None
    if result.accel is None or result.standstills is None:
        raise InputError(
            f"{source}: the gyro has no reference: give the true rates in columns such as ref_gz, or "
            "means of the accelerometer"
        )
    poses = result.standstills
    force = result.accel.correct(poses.accel)
    if np.isfinite(poses.gyro_sigma).all():
        if (by_earth_rate := try_earth_rate(poses, force, options.latitude, notes)) is not None:
            return by_earth_rate
    elif options.latitude is not None:
        notes.append("Earth rate is not used, as the noise of the gyro's means is unknown: give --mean-sigma")
    bias, covariance, g_sensitivity, g_sigma = estimate_static_bias(
        poses.gyro, np.nan_to_num(poses.gyro_sigma), force
    )
    notes.append(
        "gyro scale and misalignments left out: means of poses do not contain the turns between them"
    )
    return TriadCalibration(
        Triad(bias),
        np.pad(covariance + np.eye(3) * EARTH_RATE**2 / 3 / len(poses), (0, 9)),
        np.zeros(9, bool),
        f"bias alone, from {len(poses)} pose means",
        g_sensitivity,
        g_sigma,
    )
