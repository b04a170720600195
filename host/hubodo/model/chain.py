"""The sensor chain between the true motion and the chip's quantiser: constant bias and white noise."""

from dataclasses import dataclass

import numpy as np

from hubodo.model.frames import Array


@dataclass(frozen=True)
class SensorErrors:
    """Errors of one IMU, usable as the disturbance of an emulated chip.

    gyro_noise: rad/s, accel_noise: m/s², 1 sigma per sample. gyro_bias: rad/s, accel_bias: m/s², node axes.
    """

    gyro_noise: float
    accel_noise: float
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __call__(self, t: Array, gyro: Array, accel: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """The motion with its errors; t: (N,) s, gyro: (N, 3) rad/s, accel: (N, 3) m/s²."""
        return (
            gyro + np.asarray(self.gyro_bias) + self.gyro_noise * rng.standard_normal(gyro.shape),
            accel + np.asarray(self.accel_bias) + self.accel_noise * rng.standard_normal(accel.shape),
        )
