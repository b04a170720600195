"""Six-state Kalman filter of Barshan and Durrant-Whyte: orientation with three derivatives, and bias."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array


@dataclass(frozen=True)
class SixState:
    """The filter of eq. (7) to (12), with white noise on the third derivative of the orientation.

    c1, c2: parameters of the warm-up model, rad/s; time_constant: s. noise: 1 sigma of a rate sample, rad/s.
    highest_derivative: noise of the third derivative, rad/s^3 (sigma_a of the paper, 0.05 deg/s^3). dt: s.
    bias_noise: root spectral density of the bias state, rad/s per sqrt(s); None uses `noise`, as printed.
    """

    c1: float
    c2: float
    time_constant: float
    noise: float
    dt: float
    highest_derivative: float = math.radians(0.05)
    bias_noise: float | None = None

    def run(self, rates: Array, bias: Array, averaged: int) -> tuple[Array, Array, Array]:
        """Return orientation (rad), rate and bias (rad/s), each (N,) or (M, N), for rates of that shape.

        bias: (M,) or scalar initial bias, the mean of `averaged` samples at standstill. The gains do not
        depend on the data, so M runs are filtered at once.
        """
        runs = np.atleast_2d(rates)
        transition, drive = self._transition()
        state = np.zeros((6, len(runs)))
        state[5] = bias
        built = np.empty((3, *runs.shape))
        for k, gain in enumerate(self._gains(transition, runs.shape[1], averaged)):
            state = transition @ state
            state[5] += drive
            state += gain[:, None] * (runs[:, k] - state[1] - state[5])
            built[:, :, k] = state[[0, 1, 5]]
        shaped = built.reshape(3, *np.shape(rates))
        return shaped[0], shaped[1], shaped[2]

    def _transition(self) -> tuple[Array, float]:
        """Return F of eq. (9), and the constant input of eq. (10) on the bias."""
        dt, constant = self.dt, self.time_constant
        matrix = np.zeros((6, 6))
        for row in range(4):
            for column in range(row, 4):
                matrix[row, column] = dt ** (column - row) / math.factorial(column - row)
        matrix[4, 4], matrix[4, 5], matrix[5, 5] = 1.0, dt, constant / (constant + dt)
        return matrix, dt / (constant + dt) * (self.c1 + self.c2)

    def _process_noise(self) -> Array:
        """Return Q of eq. (11): white noise on the derivative above the highest state of each chain."""
        built = np.zeros((6, 6))
        built[:4, :4] = self.highest_derivative**2 * _white_noise(4, self.dt)
        built[4:, 4:] = (self.noise if self.bias_noise is None else self.bias_noise) ** 2 * _white_noise(
            2, self.dt
        )
        return built

    def _gains(self, transition: Array, count: int, averaged: int) -> Array:
        """Return the (N, 6) Kalman gains."""
        observed = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 1.0])
        process = self._process_noise()
        # The initial covariance is that of a stationary sensor, known to within the noise of one sample.
        spread = np.diag([0.0, self.noise**2, math.radians(1.0) ** 2, math.radians(1.0) ** 2, 0.0, 0.0])
        spread[5, 5] = self.noise**2 / averaged
        gains = np.empty((count, 6))
        for k in range(count):
            spread = transition @ spread @ transition.T + process
            column = spread @ observed
            innovation = float(observed @ column) + self.noise**2
            gains[k] = column / innovation
            spread = spread - np.outer(gains[k], column)
        return gains


def _white_noise(order: int, dt: float) -> Array:
    """Return the (order, order) covariance after dt of integrators driven by unit continuous white noise."""
    powers = order - 1 - np.arange(order)
    factorials = np.array([math.factorial(p) for p in powers], float)
    total = powers[:, None] + powers[None, :] + 1
    built: Array = dt**total / (np.outer(factorials, factorials) * total)
    return built
