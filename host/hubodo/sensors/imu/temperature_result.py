"""Terms of the temperature in an IMU calibration: as effects of the calibration file, and as remarks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.effects.temperature import POLYNOMIAL_SUFFIXES
from hubodo.effects.triad import XYZ
from hubodo.sensors.imu.accel_temperature import AccelTemperatureModel
from hubodo.sensors.imu.gyro_temperature import GyroPolynomial
from hubodo.sensors.imu.pose_temperature import PoseTemperature
from hubodo.sensors.imu.scalar_calibration import ScalarCalibration


@dataclass(frozen=True)
class TemperatureTerms:
    """The terms of the temperature that a calibration determined.

    Attributes:
        temperatures: temperatures of the poses.
        accel: terms of the accelerometers, if significant.
        accel_sigma: (T, 3) 1σ of their coefficients.
        accel_triad: (2, 3) bias, m/s², and diagonal of the matrix, which the coefficients refer to.
        gyro: polynomials of the gyros, if significant.
        gyro_scale, gyro_scale_sigma: (3,) 1/°C, if significant.
    """

    temperatures: PoseTemperature
    accel: AccelTemperatureModel | None = None
    accel_sigma: Array | None = None
    accel_triad: Array | None = None
    gyro: GyroPolynomial | None = None
    gyro_scale: Array | None = None
    gyro_scale_sigma: Array | None = None

    def effects(self) -> dict[str, Mapping[str, Quantity]]:
        """Return the parameters by effect name."""
        effects: dict[str, Mapping[str, Quantity]] = {}
        if self.gyro is not None:
            sigma = np.sqrt(np.array([np.diag(one) for one in self.gyro.covariance])).T
            effects["gyro_temperature"] = _polynomials(self.gyro.coefficients, sigma)
        if self.gyro_scale is not None and self.gyro_scale_sigma is not None:
            effects["gyro_scale_temperature"] = _by_axis(self.gyro_scale, self.gyro_scale_sigma)
        if self.accel is not None and self.accel_sigma is not None and self.accel_triad is not None:
            bias, diagonal = self.accel_triad
            values = self.accel.coefficients[: self.accel.order] * self.accel.gravity
            sigma = self.accel_sigma[: self.accel.order] * self.accel.gravity
            if self.accel.has_scale:
                scale = self.accel.coefficients[-1]
                effects["accel_scale_temperature"] = _by_axis(
                    scale * diagonal, self.accel_sigma[-1] * diagonal
                )
                # The scale acts on the reading, which contains the bias.
                values = values if len(values) else np.zeros((1, 3))
                sigma = sigma if len(sigma) else np.abs(bias * self.accel_sigma[-1:])
                values = values + np.vstack([scale * bias, np.zeros((len(values) - 1, 3))])
            effects["accel_temperature"] = _polynomials(values, sigma)
        return effects

    def notes(self) -> list[str]:
        """Return a line on what was determined, and one on each assumption."""
        low, high = float(self.temperatures.poses.min()), float(self.temperatures.poses.max())
        span = f"{low:.1f} to {high:.1f} °C"
        followers = []
        if self.gyro is not None:
            followers.append(f"gyro biases (order {self.gyro.order})")
        if self.gyro_scale is not None:
            followers.append("gyro scales")
        if self.accel is not None and self.accel.order:
            followers.append(f"accelerometer biases (order {self.accel.order})")
        if self.accel is not None and self.accel.has_scale:
            followers.append("accelerometer scales")
        if not followers:
            return [f"the temperature changes from {span}; no term of it is significant"]
        lines = [
            f"{', '.join(followers)} follow the temperature from {span} and are stated at 25 °C, others at "
            "the mean of the poses"
        ]
        if self.gyro is not None and self.gyro.hysteresis is not None:
            largest = math.degrees(float(self.gyro.hysteresis.max()))
            lines.append(
                f"hysteresis: at one temperature the gyros read up to {2.0 * largest:.2g} deg/s more or less "
                "while it rises than while it falls; the sigmas of the biases include half of it"
            )
        if self.temperatures.is_one_way:
            lines.append(
                "the temperature changes in one direction only, so a drift in time would look the same; heat "
                "and cool the node to separate them"
            )
        return lines


def accel_terms(
    temperatures: PoseTemperature, model: AccelTemperatureModel | None, calibration: ScalarCalibration
) -> TemperatureTerms:
    """Return the terms of the accelerometers; the calibration was fitted beside them."""
    if model is None:
        return TemperatureTerms(temperatures)
    triad = np.array([calibration.triad.bias, np.diag(calibration.triad.matrix)])
    return TemperatureTerms(
        temperatures, model.add(calibration.pose_terms), calibration.pose_term_sigma, triad
    )


def _by_axis(values: Array, sigma: Array) -> dict[str, Quantity]:
    return {axis: Quantity(float(v), float(s)) for axis, v, s in zip(XYZ, values, sigma, strict=True)}


def _polynomials(values: Array, sigma: Array) -> dict[str, Quantity]:
    """Return the parameters of polynomials with coefficients (order, 3)."""
    return {
        axis + suffix: Quantity(float(values[n, k]), float(sigma[n, k]))
        for n, suffix in enumerate(POLYNOMIAL_SUFFIXES[: len(values)])
        for k, axis in enumerate(XYZ)
    }
