"""Calibration of a gyro triad by a vector of known length: Earth rate, or the rate of a rate table."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.earth import EARTH_RATE
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.latitude_check import check_latitude
from hubodo.sensors.imu.misalignment import align_by_earth_rate, rotate_triad
from hubodo.sensors.imu.result import TriadCalibration
from hubodo.sensors.imu.scalar_calibration import ScalarCalibration, fit_scalar_calibration
from hubodo.sensors.imu.standstills import Standstills, find_standstills, find_steady_turns
from hubodo.sensors.imu.turn_calibration import calibrate_from_turns
from hubodo.sensors.imu.turns import collect_turns

MIN_EARTH_RATE_SNR = 10.0
"""Minimum ratio of Earth rate to its sigma in a standstill.

Below it the directions in eq. 5 are mostly noise, and the bias of their squares, 1/SNR², exceeds one per
cent.
"""
_SYMMETRIC = "gyro misalignments by the symmetric convention"


def earth_rate_deficit(standstills: Standstills) -> str:
    """Return why the gyros do not measure Earth rate in these standstills, or ""."""
    noise = float(np.sqrt((standstills.gyro_sigma**2).mean(axis=1)).max())
    if noise * MIN_EARTH_RATE_SNR < EARTH_RATE:
        return ""
    text = (
        f"gyros too noisy for Earth rate: a standstill determines the rate to {noise:.2g} rad/s, Earth rate "
        f"is {EARTH_RATE:.2g}"
    )
    if standstills.are_means:
        return text
    needed = float(np.median(standstills.duration)) * (noise * MIN_EARTH_RATE_SNR / EARTH_RATE) ** 2
    return f"{text}; standstills of {needed:.0f} s would be needed, if the bias is stable that long"


def calibrate_gyro_alone(
    t: Array, gyro: Array, table_rate: float | None, min_standstill: float
) -> tuple[Standstills | None, TriadCalibration]:
    """Calibrate a gyro triad without an accelerometer, by the table's rate (rad/s), else by Earth rate.

    Returns the standstills, if Earth rate was used. Raises CalibrationError if there is no reference.
    """
    if table_rate is not None:
        calibration, method = _fit_steady_turns(t, gyro, np.zeros(3), table_rate)
        return None, _without_frame(calibration, method)
    standstills = find_standstills(t, gyro, np.zeros((len(t), 0)), min_duration=min_standstill)
    if deficit := earth_rate_deficit(standstills):
        raise CalibrationError(
            f"a gyro alone needs a reference: give the rate of a rate table with --table-rate-deg-s, or "
            f"record the accelerometer too ({deficit})"
        )
    return standstills, _without_frame(*_fit_earth_rate(standstills))


def _without_frame(calibration: ScalarCalibration, method: str) -> TriadCalibration:
    """Return a scalar calibration whose rotation against the accelerometer is unknown."""
    return TriadCalibration(calibration.triad, calibration.full_covariance, np.ones(9, bool), method)


def _fit_earth_rate(standstills: Standstills) -> tuple[ScalarCalibration, str]:
    calibration = fit_scalar_calibration(standstills.gyro, EARTH_RATE, standstills.gyro_sigma, name="gyro")
    return calibration, f"Earth rate in {len(standstills)} standstills by the scalar method"


def _fit_steady_turns(t: Array, gyro: Array, bias: Array, table_rate: float) -> tuple[ScalarCalibration, str]:
    steady_rates, sigma = find_steady_turns(t, gyro, table_rate, bias)
    # Earth rate adds an unknown component to the table's rate.
    sigma = np.sqrt(sigma**2 + EARTH_RATE**2 / 3)
    method = f"table rate of {table_rate:.6g} rad/s in {len(steady_rates)} steady turns by the scalar method"
    return fit_scalar_calibration(steady_rates, table_rate, sigma, name="gyro"), method


def calibrate_by_earth_rate(
    standstills: Standstills, force: Array, latitude: float, notes: list[str]
) -> TriadCalibration:
    """Return the calibration by Earth rate in standstills, with `force` (R, 3) m/s² and the latitude, rad."""
    calibration, method = _fit_earth_rate(standstills)
    rate = calibration.triad.correct(standstills.gyro)
    noise = np.sqrt((standstills.gyro_sigma**2).mean(axis=1))
    check_latitude(force, rate, float(np.sqrt(np.mean(noise**2))), latitude)
    try:
        alignment = align_by_earth_rate(force, rate, noise, latitude)
    except CalibrationError as error:
        notes.append(f"{_SYMMETRIC} alone: {error}")
        return _without_frame(calibration, method)
    triad = rotate_triad(calibration.triad, alignment.angle)
    # A rotation by a small vector `angle` adds [angle x]' to the symmetric M.
    jacobian = np.zeros((12, 3))
    for k, e in enumerate(np.eye(3)):
        jacobian[3:, k] = ((rotate_triad(triad, 1e-6 * e).matrix - triad.matrix) / 1e-6).ravel()
    covariance = calibration.full_covariance + jacobian @ alignment.covariance @ jacobian.T
    method += (
        "; all six misalignments in the accelerometer's frame from the angle between gravity and Earth rate"
    )
    return TriadCalibration(triad, covariance, np.ones(9, bool), method)


def calibrate_by_table(
    t: Array, gyro: Array, standstills: Standstills, force: Array, table_rate: float, notes: list[str]
) -> TriadCalibration:
    """Return the calibration by steady turns on a rate table, with `force` (R, 3) m/s² of the standstills."""
    calibration, method = _fit_steady_turns(t, gyro, standstills.gyro.mean(axis=0), table_rate)
    bias_sigma = calibration.sigma[:3]
    try:
        turns = calibrate_from_turns(
            collect_turns(t, gyro, calibration.triad.bias, standstills, force), bias_sigma
        )
        if turns.deficit:
            raise CalibrationError(turns.deficit)
    except CalibrationError as error:
        notes.append(f"{_SYMMETRIC} alone: {error}")
        return _without_frame(calibration, method)
    # Scale factors come from the table, the frame from the turns: rotate by the closest rotation between
    # both.
    u, _, vt = np.linalg.svd(np.linalg.solve(calibration.triad.matrix, turns.matrix))
    triad = Triad(calibration.triad.bias, np.asarray(calibration.triad.matrix @ u @ vt))
    covariance = calibration.full_covariance.copy()
    covariance[3:, 3:] += turns.covariance[3:, 3:]
    method += "; all six misalignments in the accelerometer's frame from the turns between standstills"
    return TriadCalibration(triad, covariance, np.ones(9, bool), method, turns=turns)
