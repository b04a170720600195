"""Turns between standstills: the integrated rate must rotate gravity from pose to pose.

With C the attitude (node to world), dC/dt = C [omega x], and gravity fixed in space, the specific force in
node axes after the turn is f_end = R' f_start, with R the product of exp([omega dt x]) over the turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.sensors.imu.quaternions import (
    chain_product,
    chain_products_after,
    cross,
    inverse_matrices,
    quaternions_from_vectors,
    rotate_inverse,
)
from hubodo.sensors.imu.standstills import Standstills

_TURN_PADDING_S = 0.1
_MAX_INTERVAL = 0.1
"""Longest time between samples of a turn, s, unless all intervals are that long: in 0.3 s at 1 rad/s the mean
of two rates is wrong by up to a degree.
"""
NO_VALUES: Array = np.zeros(0)


@dataclass(frozen=True)
class Turns:
    """The gyro samples of T turns, padded to a common length L with steps of zero duration.

    Attributes:
        rate: (T, L, 3) mean rate of each step without bias, rad/s.
        change: (T, L, 3) change of the rate within each step, rad/s.
        dt: (T, L) duration of each step, s.
        start, end: (T, 3) unit vectors of gravity in node axes before and after the turn.
        number: (T,) number of the turn in the record.
        defect: (T,) why the gyros did not measure the turn (saturated, samples missing), or "".
        earth_slopes: (T, 3, E) derivatives of the misclosures by horizontal Earth rates, or None; see
            `earth_in_turns`.
        earth_sigma: prior sigma of these rates, rad/s.
        term_slopes: (T, 3, K) derivatives by other terms, or None; see `nonlinear_gyros`.
        temperature: (T,) °C, or None if it does not change.
        noise: sigma of a component of the misclosure by the noise of the standstills, rad; few turns
            may fit by chance.
    """

    rate: Array
    change: Array
    dt: Array
    start: Array
    end: Array
    number: NDArray[np.int64]
    defect: NDArray[np.str_]
    earth_slopes: Array | None = None
    earth_sigma: float = 0.0
    noise: float = 0.0
    term_slopes: Array | None = None
    temperature: Array | None = None

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Turns:
        """Return the selected turns, by index or mask."""
        return Turns(
            self.rate[which],
            self.change[which],
            self.dt[which],
            self.start[which],
            self.end[which],
            self.number[which],
            self.defect[which],
            None if self.earth_slopes is None else self.earth_slopes[which],
            self.earth_sigma,
            self.noise,
            None if self.term_slopes is None else self.term_slopes[which],
            None if self.temperature is None else self.temperature[which],
        )

    @property
    def slopes(self) -> Array:
        """Return the (T, 3, E + K) derivatives of the misclosures by Earth rates and other terms."""
        parts = [it for it in (self.earth_slopes, self.term_slopes) if it is not None]
        return np.concatenate([np.zeros((*self.start.shape, 0)), *parts], axis=2)

    @property
    def angle(self) -> Array:
        """Return the (T,) angles by which gravity turned in node axes, rad."""
        return angle_between(self.start, self.end)


def collect_turns(t: Array, gyro: Array, bias: Array, standstills: Standstills, gravity: Array) -> Turns:
    """Return the turns between consecutive standstills.

    t: (N,) s. gyro: (N, 3) uncalibrated, rad/s. bias: (3,), or (N, 3) if it depends on the specific force.
    gravity: (R, 3) calibrated accelerometer means of the standstills. Only the motion is included, which
    limits the effect of a residual bias.
    """
    unit = gravity / np.linalg.norm(gravity, axis=1)[:, None]
    step = float(np.median(np.diff(t)))
    pad = max(1, round(_TURN_PADDING_S / step))
    extreme = np.abs(gyro).max(axis=0)
    spans = [
        (int(standstills.end[k]) - 1 - pad, int(standstills.start[k + 1]) + 1 + pad)
        for k in range(len(standstills) - 1)
    ]
    spans = [(max(0, i), min(len(t), j)) for i, j in spans]
    length = max((j - i - 1 for i, j in spans), default=1)
    rate, change = np.zeros((2, len(spans), length, 3))
    dt = np.zeros((len(spans), length))
    defect = np.zeros(len(spans), "U40")
    max_interval = max(_MAX_INTERVAL, 1.5 * step)
    for k, (i, j) in enumerate(spans):
        w = gyro[i:j] - (bias if bias.ndim == 1 else bias[i:j])
        rate[k, : j - i - 1] = (w[1:] + w[:-1]) / 2
        change[k, : j - i - 1] = np.diff(w, axis=0)
        dt[k, : j - i - 1] = np.diff(t[i:j])
        interval = float(dt[k].max())
        if interval > max_interval:
            defect[k] = f"samples are missing for {interval:.2g} s"
        elif ((np.abs(gyro[i:j]) >= extreme * 0.9999).sum(axis=0) >= 4).any():
            defect[k] = "the gyro was clipped"
    noise = _misclosure_noise(standstills, gravity, float(dt.sum(axis=1).mean()) if spans else 0.0)
    return Turns(rate, change, dt, unit[:-1], unit[1:], np.arange(len(spans)), defect, noise=noise)


def _misclosure_noise(standstills: Standstills, gravity: Array, duration: float) -> float:
    """Return the sigma of a component of the misclosure of turns of `duration` s, rad.

    It has the error of two directions of gravity, and the random walk of the integrated rates.
    """
    direction = 2.0 * np.mean(standstills.accel_sigma**2) / np.mean((gravity**2).sum(axis=1))
    walk = np.mean(standstills.gyro_sigma**2 * standstills.duration[:, None])
    return float(np.sqrt(direction + walk * duration))


def turn_rotations(turns: Turns, matrix: Array, bias_change: Array | float = 0.0) -> Array:
    """Return the (T, 3, 3) rotations of the turns, from node axes after the turn to node axes before it."""
    total = chain_product(quaternions_from_vectors(_rotation_vectors(turns, matrix, bias_change))).T
    return np.stack([rotate_inverse(total, np.broadcast_to(e, turns.start.shape)) for e in np.eye(3)], axis=1)


def propagate_gravity(turns: Turns, matrix: Array, bias_change: Array | float = 0.0) -> Array:
    """Return the (T, 3) directions of gravity at the end of each turn, propagated by the gyros."""
    return rotate_inverse(
        chain_product(quaternions_from_vectors(_rotation_vectors(turns, matrix, bias_change))).T, turns.start
    )


def propagate_gravity_jacobian(turns: Turns, matrix: Array, bias_change: Array) -> tuple[Array, Array]:
    """Return `propagate_gravity` and its (T, 3, 12) derivatives by `matrix`, row by row, and `bias_change`.

    If the rotation vector a of a step changes by da, gravity u at the end changes by u x f with
    f = S' (1 - [a x] / 2 + [a x]² / 6) da, where S is the product of the later steps: the right Jacobian
    of SO(3) (Sola, Deray, Atchuthan 2018) to second order in a. The derivative of the coning term is
    neglected (relative size 1e-4).
    """
    angle = _rotation_vectors(turns, matrix, bias_change)
    total, later_products = chain_products_after(quaternions_from_vectors(angle))
    end = rotate_inverse(total.T, turns.start)
    x, y, z = 0.5 * np.moveaxis(angle, -1, 0)
    diagonal = 1.0 - (x * x + y * y + z * z) / 1.5
    jacobian_first_order = np.array([[diagonal, z, -y], [-z, diagonal, x], [y, -x, diagonal]])
    # [a x]² = a a' - a²
    step_effect = (
        np.moveaxis(jacobian_first_order, (0, 1), (-2, -1)) + angle[..., :, None] * angle[..., None, :] / 6.0
    )
    inverse = np.linalg.inv(matrix)
    step_effect = inverse_matrices(later_products) @ step_effect
    rates_and_bias = np.concatenate(
        [(turns.rate - bias_change) @ inverse.T, np.ones((*turns.dt.shape, 1))], axis=-1
    )
    rates_and_bias = rates_and_bias * turns.dt[..., None]
    # (T, 3, 4, 3): derivative of f by each column of the inverse, for each axis of the rate and for the bias.
    sums = (step_effect.reshape(*rates_and_bias.shape[:2], 9).transpose(0, 2, 1) @ rates_and_bias).reshape(
        -1, 3, 3, 4
    )
    sums = -sums.transpose(0, 1, 3, 2) @ inverse
    gravity_effect = np.concatenate(
        [sums[:, :, :3].transpose(0, 1, 3, 2).reshape(-1, 3, 9), sums[:, :, 3]], axis=-1
    )
    return end, np.cross(end[:, :, None], gravity_effect, axis=1)


def _rotation_vectors(turns: Turns, matrix: Array, bias_change: Array | float) -> Array:
    """Return the (T, L, 3) rotation vectors of the node in each step, rad."""
    inverse = np.linalg.inv(matrix)
    rate = (turns.rate - bias_change) @ inverse.T
    dt = turns.dt[..., None]
    # Second term: coning for a rate that changes linearly within the step, w0 x w1 dt²/12.
    return np.asarray(rate * dt + cross(rate, turns.change @ inverse.T) * dt**2 / 12)


def turn_errors(
    turns: Turns, matrix: Array, bias_change: Array | float = 0.0, others: Array = NO_VALUES
) -> Array:
    """Return the (T,) angles between propagated and measured gravity, rad, less the effect of `others`.

    others: (E + K,) Earth rates and other terms, or none.
    """
    end = propagate_gravity(turns, matrix, bias_change)
    if len(others):
        end = end - turns.slopes @ others
    return angle_between(end, turns.end)


def angle_between(a: Array, b: Array) -> Array:
    """Return the angles between vectors (T, 3), rad."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))
