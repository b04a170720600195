"""Steps of an IMU calibration at changing temperature: gyro polynomials first, biases at 25 °C last."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.triad import Triad
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.sensors.imu.gyro_temperature import fit_gyro_polynomial
from hubodo.sensors.imu.result import TriadCalibration
from hubodo.sensors.imu.standstills import Standstills
from hubodo.sensors.imu.temperature_result import TemperatureTerms


def subtract_gyro_polynomial(
    gyro: Array, standstills: Standstills, terms: TemperatureTerms, order: int | None
) -> tuple[Array, Standstills, TemperatureTerms]:
    """Return gyro samples (N, 3) and standstills at the mean temperature of the poses, and the polynomial."""
    polynomial = fit_gyro_polynomial(standstills.gyro, standstills.gyro_sigma, terms.temperatures, order)
    if polynomial is None:
        return gyro, standstills, terms
    means = standstills.gyro - polynomial.change(terms.temperatures.poses)
    return (
        gyro - polynomial.change(terms.temperatures.samples),
        replace(standstills, gyro=means),
        replace(terms, gyro=polynomial),
    )


def state_at_reference(
    calibrated: TriadCalibration, terms: TemperatureTerms
) -> tuple[TriadCalibration, TemperatureTerms]:
    """Return the calibration of the gyros at 25 °C instead of the mean temperature of the poses."""
    triad, covariance = calibrated.triad, calibrated.covariance.copy()
    bias, matrix = triad.bias, triad.matrix
    if terms.gyro is not None:
        bias, covariance[:3, :3] = terms.gyro.bias_at_reference(bias, covariance[:3, :3])
    turns = calibrated.turns
    if turns is not None and turns.scale_per_degree is not None and turns.scale_per_degree_sigma is not None:
        warmth = REFERENCE_CELSIUS - turns.mean_temperature
        scale, sigma = turns.scale_per_degree, turns.scale_per_degree_sigma
        matrix = matrix + np.diag(warmth * scale)
        index = [3, 7, 11]
        covariance[index, index] += (warmth * sigma) ** 2
        terms = replace(terms, gyro_scale=scale * np.diag(matrix), gyro_scale_sigma=sigma)
    return replace(calibrated, triad=Triad(bias, matrix), covariance=covariance), terms
