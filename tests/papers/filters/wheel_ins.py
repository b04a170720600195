"""Wheel-INS, a published method of dead reckoning with one IMU on one wheel, written from its equations.

Niu, Wu and Kuang, "Wheel-INS: A Wheel-Mounted MEMS IMU-Based Dead Reckoning System", IEEE Transactions on
Vehicular Technology 70 (2021), doi 10.1109/TVT.2021.3108008: strapdown navigation of the IMU on the wheel,
with an error-state Kalman filter of 21 states. Every half a second the wheel's speed (its rate times its
radius) and the absence of motion sideways and upwards are measured in the vehicle's axes. Earth rotation is
neglected.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY

_GRAVITY = np.array([0.0, 0.0, -STANDARD_GRAVITY])
_HOUR_S = 3600.0
_SPEED_WINDOW_S = 0.1
"""Span over which the rate about the axle is averaged for the measured speed, as in the method's program."""
_VELOCITY, _ATTITUDE, _GYRO_BIAS, _ACCEL_BIAS, _GYRO_SCALE, _ACCEL_SCALE = (
    slice(first, first + 3) for first in range(3, 21, 3)
)


@dataclass(frozen=True)
class WheelInsNoise:
    """Settings of the filter, 1 sigma each; by default those that its authors publish for their car.

    gyro_density: rad/s/√Hz; accel_density: m/s²/√Hz. gyro_bias, accel_bias, gyro_scale, accel_scale: sigma of
    a Gauss-Markov process, rad/s, m/s², relative, and of its initial value. correlation_time: s. speed: of
    the velocity forwards, sideways and upwards, m/s. speed_interval: s.
    """

    gyro_density: float = math.radians(1.2) / 60.0
    accel_density: float = 6.0 / 60.0
    gyro_bias: float = math.radians(50.0) / _HOUR_S
    accel_bias: float = 2000e-5
    gyro_scale: float = 50e-6
    accel_scale: float = 500e-6
    correlation_time: float = _HOUR_S
    speed: tuple[float, float, float] = (0.035, 0.02, 0.02)
    speed_interval: float = 0.5


@dataclass(frozen=True)
class WheelInsTrack:
    """Positions of the wheel's centre. t: (M,) s; x, y: (M,) m; heading: (M,) rad, of the vehicle."""

    t: Array
    x: Array
    y: Array
    heading: Array


class WheelIns:
    """The filter on the record of one wheel; axes x forward, y left, z up, z of the node along the axle.

    radius: m. axle_sign: 1 if the node's z axis points to the left of the vehicle, -1 to the right. arm: (3,)
    position of the wheel's centre in node axes, m. gyro_bias: (3,) rad/s, such as the mean at standstill.
    """

    def __init__(
        self,
        radius: float,
        axle_sign: int = 1,
        arm: tuple[float, float, float] = (0.0, 0.0, 0.0),
        noise: WheelInsNoise | None = None,
    ) -> None:
        self.radius = radius
        self.axle_sign = axle_sign
        self.arm = np.array(arm)
        self.noise = noise or WheelInsNoise()

    def run(self, t: Array, gyro: Array, accel: Array, standstill_s: float) -> WheelInsTrack:
        """Return the track of a record that begins at standstill; t: (N,) s, gyro and accel: (N, 3)."""
        still = t < t[0] + standstill_s
        self._start(gyro[still].mean(axis=0), accel[still].mean(axis=0))
        rows = [self._row(t[0]), *self._steps(t, gyro, accel)]
        return WheelInsTrack(*np.array(rows).T)

    def _start(self, gyro_mean: Array, accel_mean: Array) -> None:
        noise = self.noise
        up = accel_mean / np.linalg.norm(accel_mean)
        left = np.array([0.0, 0.0, float(self.axle_sign)])
        left -= up * (left @ up)
        left /= np.linalg.norm(left)
        self.rotation = np.array([np.cross(left, up), left, up])
        self.position, self.velocity = np.zeros(3), np.zeros(3)
        self.gyro_bias, self.accel_bias = gyro_mean.copy(), np.zeros(3)
        self.gyro_scale, self.accel_scale = np.zeros(3), np.zeros(3)
        biases = (noise.gyro_bias, noise.accel_bias, noise.gyro_scale, noise.accel_scale)
        sigmas = (0.1, 0.05, math.radians(0.5), *biases)  # m, m/s, rad: those of the authors' car
        self.covariance = np.diag(np.repeat(sigmas, 3) ** 2)
        densities = (0.0, noise.accel_density, noise.gyro_density)
        walks = np.array(biases) * math.sqrt(2.0 / noise.correlation_time)
        self.process = np.diag(np.repeat([*densities, *walks], 3) ** 2)

    def _steps(self, t: Array, gyro: Array, accel: Array) -> Iterator[tuple[float, float, float, float]]:
        measured_at = t[0]
        window = max(1, round(_SPEED_WINDOW_S / float(np.median(np.diff(t)))))
        rates = np.zeros((len(t), 3))
        before = (np.zeros(3), np.zeros(3))
        for now in range(1, len(t)):
            dt = t[now] - t[now - 1]
            rate = (gyro[now] - self.gyro_bias) / (1.0 + self.gyro_scale)
            force = (accel[now] - self.accel_bias) / (1.0 + self.accel_scale)
            rates[now] = rate
            self._predict(rate, force, dt)
            before = self._navigate(rate * dt, force * dt, dt, *before)
            if t[now] - measured_at >= self.noise.speed_interval and now >= window:
                measured_at = t[now]
                spin = self.axle_sign * rates[now - window + 1 : now + 1, 2].mean()
                self._measure_speed(spin * self.radius, rate)
                yield self._row(t[now])

    def _navigate(
        self, angle: Array, speed: Array, dt: float, angle_before: Array, speed_before: Array
    ) -> tuple[Array, Array]:
        """Integrate rotation and velocity with the corrections for coning and sculling of two samples."""
        sculling = (np.cross(angle_before, speed) + np.cross(speed_before, angle)) / 12.0
        change = self.rotation @ (speed + np.cross(angle, speed) / 2.0 + sculling) + _GRAVITY * dt
        self.position += (self.velocity + change / 2.0) * dt
        self.velocity += change
        turn = angle + np.cross(angle_before, angle) / 12.0
        self.rotation = self.rotation @ Rotation.from_rotvec(turn).as_matrix()
        return angle, speed

    def _predict(self, rate: Array, force: Array, dt: float) -> None:
        """Propagate the covariance; errors are truth minus estimate, the attitude's in navigation axes."""
        transition = np.eye(21)
        transition[:3, _VELOCITY] = np.eye(3) * dt
        transition[_VELOCITY, _ATTITUDE] = -_cross_matrix(self.rotation @ force) * dt
        transition[_VELOCITY, _ACCEL_BIAS] = -self.rotation * dt
        transition[_VELOCITY, _ACCEL_SCALE] = -self.rotation * force * dt
        transition[_ATTITUDE, _GYRO_BIAS] = -self.rotation * dt
        transition[_ATTITUDE, _GYRO_SCALE] = -self.rotation * rate * dt
        transition[range(9, 21), range(9, 21)] -= dt / self.noise.correlation_time
        noise = self.process * dt
        self.covariance = transition @ (self.covariance + noise / 2.0) @ transition.T + noise / 2.0

    def _measure_speed(self, speed: float, rate: Array) -> None:
        to_vehicle = Rotation.from_euler("z", -self._heading()).as_matrix()
        arm_velocity = self.rotation @ np.cross(rate, self.arm)
        to_body = to_vehicle @ self.rotation
        jacobian = np.zeros((3, 21))
        jacobian[:, _VELOCITY] = to_vehicle
        jacobian[:, _ATTITUDE] = -to_vehicle @ _cross_matrix(arm_velocity)
        jacobian[:, 8] += to_vehicle @ np.cross(self.velocity + arm_velocity, [0.0, 0.0, 1.0])
        jacobian[:, _GYRO_BIAS] = to_body @ _cross_matrix(self.arm)
        jacobian[:, _GYRO_SCALE] = to_body @ _cross_matrix(self.arm) * rate
        residual = np.array([speed, 0.0, 0.0]) - to_vehicle @ (self.velocity + arm_velocity)
        projected = jacobian @ self.covariance
        noise = np.diag(np.square(self.noise.speed))
        gain = np.linalg.solve(projected @ jacobian.T + noise, projected).T
        reduction = np.eye(21) - gain @ jacobian
        self.covariance = reduction @ self.covariance @ reduction.T + gain @ noise @ gain.T
        self._correct(gain @ residual)

    def _correct(self, error: Array) -> None:
        self.position += error[:3]
        self.velocity += error[_VELOCITY]
        self.rotation = Rotation.from_rotvec(error[_ATTITUDE]).as_matrix() @ self.rotation
        self.gyro_bias += error[_GYRO_BIAS]
        self.accel_bias += error[_ACCEL_BIAS]
        self.gyro_scale += error[_GYRO_SCALE]
        self.accel_scale += error[_ACCEL_SCALE]

    def _row(self, t: float) -> tuple[float, float, float, float]:
        centre = self.position + self.rotation @ self.arm
        return t, centre[0], centre[1], self._heading()

    def _heading(self) -> float:
        """Return the vehicle's heading: the axle points to its left."""
        left = self.axle_sign * self.rotation[:, 2]
        return math.atan2(-left[0], left[1])


def _cross_matrix(vector: Array) -> Array:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
