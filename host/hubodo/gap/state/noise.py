"""Noise of each channel: estimated from residuals, and as declared in the model file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array, sin_cos
from hubodo.effects import Effect
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.state.low_pass import measure_low_pass_ratios
from hubodo.model.forward import NodeInitialState, NodeReading
from hubodo.smoothing_spline import SmoothingSpline
from hubodo.vehicle import facing_sign, side_sign

_MAX_SPIN_GROUPS = 6
_MIN_GROUP_SAMPLES = 400
# s, samples and windows for the roughness of the road, and groups of it.
_ROUGHNESS_WINDOW, _MIN_ROUGHNESS_SAMPLES, _MIN_ROUGHNESS_WINDOWS, _MAX_ROUGHNESS_GROUPS = 1.0, 20, 20, 16
# 1 sigma of ln scatter from second to second from which on the road is rough: chance makes 0.03 to 0.08 of
# constant noise, a paved road 0.4 to 0.8. Ratio of a step to the usual one beyond which it is an outlier.
_MIN_ROUGHNESS_SCATTER, _MAX_ROUGHNESS_RATIO = 0.2, 8.0
# Trimmed mean of |x| for a unit Gaussian without its largest 2.5 %: robust against outliers, and nonzero on a
# coarse lattice, where a median would vanish.
_TRIMMED_FRACTION = 0.975
_TRIMMED_MEAN_OF_UNIT_GAUSSIAN = 0.7519694


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of each channel, constant within groups of samples to save memory on long logs.

    group_sigmas: (6, G), 1 sigma in each group, estimated from the residual
    group_indices: (N,), the group of each sample
    is_new: (N,), False where a sample repeats its predecessor in all channels
    """

    group_sigmas: Array
    group_indices: NDArray[np.uint8]
    is_new: NDArray[np.bool_]

    @property
    def sigma(self) -> Array:
        """Return 1 sigma of each channel and sample, (6, N)."""
        return self.sigma_at(slice(None))

    def sigma_at(self, samples: slice) -> Array:
        """Return 1 sigma of each channel, (6, n), at some samples."""
        return self.group_sigmas.take(self.group_indices[samples], axis=1)

    def channel_sigma(self, row: int | np.integer[Any]) -> Array:
        """Return 1 sigma, (N,), of one channel."""
        return np.asarray(self.group_sigmas[row].take(self.group_indices))

    def exclude(self, samples: NDArray[np.bool_]) -> ChannelNoise:
        """Return a copy with infinite noise at some samples, (N,), which removes them from any fit."""
        levels = np.append(self.group_sigmas, np.full((6, 1), np.inf), axis=1)
        group = np.where(samples, np.uint8(self.group_sigmas.shape[1]), self.group_indices)
        return ChannelNoise(levels, group, self.is_new)


def estimate_channel_noise(
    problem: Problem, node: NodeData, reading: NodeReading, residual: Array
) -> ChannelNoise:
    """Estimate the noise of a node's channels from their residual, (6, N), in groups of similar noise.

    On a road the noise varies from second to second with the surface: then groups are of similar roughness,
    otherwise of similar spin. Gyros that low-pass their noise have the level of the band of motion.
    """
    is_new = np.concatenate([[True], (np.diff(node.y, axis=1) != 0.0).any(axis=0)])
    spin = np.zeros(len(node.t)) if reading.rolling is None else np.abs(reading.rolling.spin)
    usable = is_new & ~node.is_saturated
    roughness = _measure_roughness(node, residual, usable)
    bins = _group_by_spin(spin) if roughness is None else _group_in_order(roughness, _MAX_ROUGHNESS_GROUPS)
    levels, group = np.empty((6, len(bins))), np.empty(len(node.t), np.uint8)
    overall = _estimate_white_sigma(residual, np.flatnonzero(usable.all(axis=0)))
    for k, members in enumerate(bins):
        group[members] = k
        for row in range(6):
            inside = members[usable[row, members]]
            is_sufficient = len(inside) > _MIN_GROUP_SAMPLES // 4
            levels[row, k] = (
                _estimate_white_sigma(residual[[row]], inside)[0] if is_sufficient else overall[row]
            )
    levels[:3] *= measure_low_pass_ratios(node.t, residual[:3], reading)[:, None]
    minimum = np.maximum(_min_sigma(problem, node), _rounding_sigma(node))
    return ChannelNoise(np.maximum(levels, minimum[:, None]), group, is_new)


def _estimate_white_sigma(residual: Array, members: NDArray[np.intp]) -> Array:
    """Return 1 sigma of white noise in rows, (k, N), from differences of neighbouring members."""
    pairs = members[:-1][np.diff(members) == 1]
    if not len(pairs):
        return np.zeros(len(residual))
    jumps = residual[:, pairs + 1] - residual[:, pairs]
    trimmed = np.sort(np.abs(jumps), axis=1)[:, : max(1, int(_TRIMMED_FRACTION * len(pairs)))]
    return np.asarray(trimmed.mean(axis=1) / _TRIMMED_MEAN_OF_UNIT_GAUSSIAN / np.sqrt(2.0))


@dataclass(frozen=True)
class InputSensitivity:
    """Change of the channels, (6, N) each, per m/s of speed, m/s² of acceleration and rad/s of yaw rate.

    The wheel angle is held constant.
    """

    speed: Array
    acceleration: Array
    yaw_rate: Array


def compute_input_sensitivity(
    node: NodeData, reading: NodeReading, start: NodeInitialState
) -> InputSensitivity:
    """Return the change of a node's readings for errors of the inputs, of the ideal node without effects."""
    body, rolling = reading.body, reading.rolling
    speed, acceleration, yaw_rate = (np.zeros_like(node.y) for _ in range(3))
    if rolling is None:
        acceleration[3], speed[4] = 1.0, body.yaw_rate
        yaw_rate[2], yaw_rate[4] = 1.0, body.speed
        turn = np.kron(np.eye(2), Rotation.from_rotvec(start.attitude).as_matrix().T)
        return InputSensitivity(turn @ speed, turn @ acceleration, turn @ yaw_rate)
    facing = facing_sign(node.mount.facing or "left")
    y = side_sign(node.mount.side or "left") * node.forward.track_width / 2.0
    sin, cos = sin_cos(rolling.angle)
    speed[2], speed[5] = facing / node.forward.wheel_radius, facing * body.yaw_rate
    acceleration[3], acceleration[4] = sin, facing * cos
    yaw_rate[0], yaw_rate[1], yaw_rate[2] = cos, -facing * sin, -facing * y / node.forward.wheel_radius
    yaw_rate[5] = facing * (body.speed - 2.0 * y * body.yaw_rate)
    return InputSensitivity(speed, acceleration, yaw_rate)


def declared_sensor_sigma(problem: Problem, effects: Iterable[Effect] = ()) -> Array:
    """Return the declared noise of the sensors, (6, 1), with the noise that effects add."""
    noise = problem.model.noise
    gyro, accel = noise.gyro**2, noise.accel**2
    for effect in effects:
        added = effect.added_variance(noise)
        gyro, accel = gyro + added[0], accel + added[1]
    return np.asarray(np.sqrt(np.array([gyro] * 3 + [accel] * 3))[:, None])


def declared_input_sigma(problem: Problem, sensitivity: InputSensitivity) -> Array:
    """Return 1 sigma, (6, N), of the channels due to the declared noise of the inputs after smoothing."""
    v, v_slope = _smoothed_sigmas(problem.inputs.speed, problem.speed_noise)
    r, _ = _smoothed_sigmas(problem.inputs.yaw_rate, problem.yaw_rate_noise)
    squares = (
        (sensitivity.speed * v) ** 2
        + (sensitivity.acceleration * v_slope) ** 2
        + (sensitivity.yaw_rate * r) ** 2
    )
    return np.asarray(np.sqrt(squares))


def _smoothed_sigmas(source: SmoothingSpline, declared: float) -> tuple[float, float]:
    """Return 1 sigma of the declared noise that remains in a smoothed input and in its slope."""
    if source.noise <= 0.0:
        return 0.0, 0.0
    share = declared / source.noise
    return share * source.value_noise, share * source.slope_noise


def _group_by_spin(spin: Array) -> list[NDArray[np.intp]]:
    return _group_in_order(spin, _MAX_SPIN_GROUPS)


def _group_in_order(value: Array, max_groups: int) -> list[NDArray[np.intp]]:
    """Return groups of samples of equal size, in ascending order of a value, (N,)."""
    count = int(np.clip(len(value) // _MIN_GROUP_SAMPLES, 1, max_groups))
    order = np.argsort(value, kind="stable")
    return [np.sort(part) for part in np.array_split(order, count)]


def _measure_roughness(node: NodeData, residual: Array, usable: NDArray[np.bool_]) -> Array | None:
    """Return ln of the scatter about each sample, (N,), relative to its mean; None if it hardly varies.

    The scatter is that of differences of neighbours within a second, of all channels together.
    """
    complete = np.asarray(usable.all(axis=0))
    inside = complete[1:] & complete[:-1]
    window = ((node.t - node.t[0]) / _ROUGHNESS_WINDOW).astype(np.intp)
    count = np.bincount(window[1:], inside)
    is_known = np.asarray(count >= _MIN_ROUGHNESS_SAMPLES)
    if np.count_nonzero(is_known) < _MIN_ROUGHNESS_WINDOWS:
        return None
    logs = np.zeros(len(count))
    for row in np.flatnonzero(node.used):
        step = np.abs(np.diff(residual[row])) * inside
        usual = float(np.mean(step[inside]))
        step = np.minimum(step, _MAX_ROUGHNESS_RATIO * usual)
        logs += np.log(np.maximum(np.bincount(window[1:], step) / np.maximum(count, 1.0), 1e-3 * usual))
    logs /= max(int(np.count_nonzero(node.used)), 1)
    if np.std(logs[is_known]) < _MIN_ROUGHNESS_SCATTER:
        return None
    logs = np.interp(np.arange(len(logs)), np.flatnonzero(is_known), logs[is_known])
    return np.asarray(logs[window])


def _min_sigma(problem: Problem, node: NodeData) -> Array:
    """Return the smallest credible noise, (6,): a hundredth of the declared noise."""
    noise = problem.model.noise
    return 0.01 * np.array([noise.gyro] * 3 + [noise.accel] * 3)


def _rounding_sigma(node: NodeData) -> Array:
    """Return 1 sigma of the rounding error, (6,): lattice step / √12.

    On a coarse lattice a steady channel reads one constant value, and its scatter would understate the error.
    """
    return np.asarray(np.where(np.isfinite(node.lattice_steps), node.lattice_steps, 0.0) / np.sqrt(12.0))
