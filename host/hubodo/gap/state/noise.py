"""How noisy each channel really is, whatever the model declares, and how noisy it ought to be."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.model.forward import NodeInitialState, NodeReading
from hubodo.smoothing_spline import SmoothingSpline
from hubodo.vehicle import facing_sign, side_sign

_BINS = 6
_LEAST_IN_BIN = 400
# The mean of |x| of a Gaussian of 1 sigma without its largest fortieth: steps of a coarse lattice do not
# make it zero, and a few wild samples do not make it large.
_KEPT = 0.975
_TRIMMED_MEAN = 0.7519694


@dataclass(frozen=True)
class ChannelNoise:
    """How noisy each channel is, alike for all samples of a group: of a long log, few numbers.

    levels: (6, G), 1 sigma in each group as the residual shows it. group: (N,), that of each sample. fresh:
    (N,) samples that are not their predecessor sent again.
    """

    levels: Array
    group: NDArray[np.uint8]
    fresh: NDArray[np.bool_]

    @property
    def found(self) -> Array:
        """(6, N): 1 sigma of each channel and sample."""
        return self.part(slice(None))

    def part(self, samples: slice) -> Array:
        """(6, n): the same of some samples."""
        return self.levels.take(self.group[samples], axis=1)

    def of(self, row: int | np.integer[Any]) -> Array:
        """(N,): the same of one channel."""
        return np.asarray(self.levels[row].take(self.group))

    def without(self, samples: NDArray[np.bool_]) -> ChannelNoise:
        """So noisy in some samples, (N,), that they say nothing."""
        levels = np.append(self.levels, np.full((6, 1), np.inf), axis=1)
        group = np.where(samples, np.uint8(self.levels.shape[1]), self.group)
        return ChannelNoise(levels, group, self.fresh)


def channel_noise(problem: Problem, node: NodeData, reading: NodeReading, residual: Array) -> ChannelNoise:
    """Noise of a node's channels from their residual, (6, N)."""
    fresh = np.concatenate([[True], (np.diff(node.y, axis=1) != 0.0).any(axis=0)])
    spin = np.zeros(len(node.t)) if reading.rolling is None else np.abs(reading.rolling.spin)
    bins, free = _bins(spin), fresh & ~node.clipped
    levels, group = np.empty((6, len(bins))), np.empty(len(node.t), np.uint8)
    whole = _scatter(residual, np.flatnonzero(free.all(axis=0)))
    for k, members in enumerate(bins):
        group[members] = k
        for row in range(6):
            inside = members[free[row, members]]
            enough = len(inside) > _LEAST_IN_BIN // 4
            levels[row, k] = _scatter(residual[[row]], inside)[0] if enough else whole[row]
    floor = np.maximum(_floor(problem, node), _rounding(node))
    return ChannelNoise(np.maximum(levels, floor[:, None]), group, fresh)


def _scatter(residual: Array, members: NDArray[np.intp]) -> Array:
    """1 sigma of white noise in rows of a residual, (k, N), from steps between neighbours of the members."""
    pairs = members[:-1][np.diff(members) == 1]
    if not len(pairs):
        return np.zeros(len(residual))
    jumps = residual[:, pairs + 1] - residual[:, pairs]
    kept = np.sort(np.abs(jumps), axis=1)[:, : max(1, int(_KEPT * len(pairs)))]
    return np.asarray(kept.mean(axis=1) / _TRIMMED_MEAN / np.sqrt(2.0))


@dataclass(frozen=True)
class InputAnswers:
    """Change of the channels, (6, N) each, by what moves the body, a wheel's angle staying as it is.

    Per m/s of speed, m/s² of acceleration and rad/s of yaw rate.
    """

    speed: Array
    acceleration: Array
    yaw_rate: Array


def input_answers(node: NodeData, reading: NodeReading, start: NodeInitialState) -> InputAnswers:
    """What an error of the inputs does to a node; effects change that little and are left out."""
    body, rolling = reading.body, reading.rolling
    speed, acceleration, yaw_rate = (np.zeros_like(node.y) for _ in range(3))
    if rolling is None:
        acceleration[3], speed[4] = 1.0, body.yaw_rate
        yaw_rate[2], yaw_rate[4] = 1.0, body.speed
        turn = np.kron(np.eye(2), Rotation.from_rotvec(start.attitude).as_matrix().T)
        return InputAnswers(turn @ speed, turn @ acceleration, turn @ yaw_rate)
    facing = facing_sign(node.mount.facing or "left")
    y = side_sign(node.mount.side or "left") * node.forward.track_width / 2.0
    cos, sin = np.cos(rolling.angle), np.sin(rolling.angle)
    speed[2], speed[5] = facing / node.forward.wheel_radius, facing * body.yaw_rate
    acceleration[3], acceleration[4] = sin, facing * cos
    yaw_rate[0], yaw_rate[1], yaw_rate[2] = cos, -facing * sin, -facing * y / node.forward.wheel_radius
    yaw_rate[5] = facing * (body.speed - 2.0 * y * body.yaw_rate)
    return InputAnswers(speed, acceleration, yaw_rate)


def sensor_noise(problem: Problem, effects: Iterable[Effect] = ()) -> Array:
    """(6, 1): what the model file declares of the sensors, with what effects add to it."""
    noise = problem.model.noise
    gyro, accel = noise.gyro**2, noise.accel**2
    for effect in effects:
        more = effect.added_variance(noise)
        gyro, accel = gyro + more[0], accel + more[1]
    return np.asarray(np.sqrt(np.array([gyro] * 3 + [accel] * 3))[:, None])


def input_noise(problem: Problem, answers: InputAnswers) -> Array:
    """(6, N): 1 sigma of what the declared noise of the inputs makes, as far as it passes the smoothing."""
    v, v_slope = _passed(problem.inputs.speed, problem.speed_noise)
    r, _ = _passed(problem.inputs.yaw_rate, problem.yaw_rate_noise)
    squares = (answers.speed * v) ** 2 + (answers.acceleration * v_slope) ** 2 + (answers.yaw_rate * r) ** 2
    return np.asarray(np.sqrt(squares))


def _passed(source: SmoothingSpline, declared: float) -> tuple[float, float]:
    """1 sigma of the declared noise that is left in a smoothed input and in its slope."""
    if source.noise <= 0.0:
        return 0.0, 0.0
    share = declared / source.noise
    return share * source.value_noise, share * source.slope_noise


def _bins(spin: Array) -> list[NDArray[np.intp]]:
    """Samples in order of their spin, in up to six groups of equal number."""
    count = int(np.clip(len(spin) // _LEAST_IN_BIN, 1, _BINS))
    order = np.argsort(spin, kind="stable")
    return [np.sort(part) for part in np.array_split(order, count)]


def _floor(problem: Problem, node: NodeData) -> Array:
    """(6,) below which no noise is believed: a hundredth of the declared one."""
    noise = problem.model.noise
    return 0.01 * np.array([noise.gyro] * 3 + [noise.accel] * 3)


def _rounding(node: NodeData) -> Array:
    """(6,): 1 sigma of what rounding hides, step / √12.

    Where a channel rests between two steps of a coarse lattice its readings are all the same, and say less of
    where it is than their scatter would have it.
    """
    return np.asarray(np.where(np.isfinite(node.steps), node.steps, 0.0) / np.sqrt(12.0))
