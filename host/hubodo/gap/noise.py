"""How noisy each channel really is, whatever the model declares, and how noisy it ought to be."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.gap.problem import NodeData, Problem
from hubodo.model.effects import Effect
from hubodo.model.forward import Reading
from hubodo.model.frames import Array

_BINS = 6
_LEAST_IN_BIN = 400
# The mean of |x| of a Gaussian of 1 sigma without its largest fortieth: steps of a coarse lattice do not
# make it zero, and a few wild samples do not make it large.
_KEPT = 0.975
_TRIMMED_MEAN = 0.7519694


@dataclass(frozen=True)
class ChannelNoise:
    """found: (6, N), 1 sigma of each channel and sample as the residual shows it.

    fresh: (N,) samples that are not their predecessor sent again.
    """

    found: Array
    fresh: NDArray[np.bool_]


def channel_noise(problem: Problem, node: NodeData, reading: Reading, rest: Array) -> ChannelNoise:
    """Noise of a node's channels from their residual, rest: (6, N)."""
    fresh = np.concatenate([[True], (np.diff(node.y, axis=1) != 0.0).any(axis=0)])
    spin = np.zeros(len(node.t)) if reading.rolling is None else np.abs(reading.rolling.spin)
    found = np.empty_like(node.y)
    free = fresh & ~node.clipped
    whole = _scatter(rest, np.flatnonzero(free.all(axis=0)))
    for members in _bins(spin):
        for row in range(6):
            inside = members[free[row, members]]
            enough = len(inside) > _LEAST_IN_BIN // 4
            found[row, members] = _scatter(rest[row : row + 1], inside)[0] if enough else whole[row]
    floor = _floor(problem, node)
    return ChannelNoise(np.maximum(found, floor[:, None]), fresh)


def _scatter(rest: Array, members: NDArray[np.intp]) -> Array:
    """1 sigma of white noise in rows of rest, (k, N), from steps between neighbours among the members."""
    pairs = members[:-1][np.diff(members) == 1]
    if not len(pairs):
        return np.zeros(len(rest))
    jumps = rest[:, pairs + 1] - rest[:, pairs]
    kept = np.sort(np.abs(jumps), axis=1)[:, : max(1, int(_KEPT * len(pairs)))]
    return np.asarray(kept.mean(axis=1) / _TRIMMED_MEAN / np.sqrt(2.0))


def declared_noise(
    problem: Problem, node: NodeData, reading: Reading, effects: Iterable[Effect] = ()
) -> Array:
    """(6, N): what the model file declares, with the inputs' noise as far as it passes the smoothing."""
    noise, inputs = problem.model.noise, problem.model.inputs
    v, v_slope = _passed(problem.inputs.speed, inputs.speed_noise)
    r, _ = _passed(problem.inputs.yaw_rate, inputs.yaw_rate_noise)
    body = reading.body
    gyro, accel = noise.gyro**2, noise.accel**2
    for effect in effects:
        more = effect.spread(noise)
        gyro, accel = gyro + more[0], accel + more[1]
    squares = np.repeat(np.array([gyro] * 3 + [accel] * 3)[:, None], len(node.t), axis=1)
    if reading.rolling is not None:
        cos, sin = np.cos(reading.rolling.angle), np.sin(reading.rolling.angle)
        squares[0] += (r * cos) ** 2
        squares[1] += (r * sin) ** 2
        squares[2] += (v / node.forward.wheel_radius) ** 2
        squares[3] += (v_slope * sin) ** 2
        squares[4] += (v_slope * cos) ** 2
        squares[5] += (body.yaw_rate * v) ** 2 + (body.speed * r) ** 2
    else:
        squares[:3] += r**2
        squares[3:] += v_slope**2 + (body.yaw_rate * v) ** 2 + (body.speed * r) ** 2
    return np.asarray(np.sqrt(squares))


def _passed(source: object, declared: float) -> tuple[float, float]:
    """1 sigma of the declared noise that is left in a smoothed input and in its slope."""
    noise = float(getattr(source, "noise", 0.0))
    if noise <= 0.0 or declared <= 0.0:
        return 0.0, 0.0
    share = declared / noise
    return share * float(getattr(source, "value_noise", 0.0)), share * float(
        getattr(source, "slope_noise", 0.0)
    )


def _bins(spin: Array) -> list[NDArray[np.intp]]:
    """Samples in order of their spin, in up to six groups of equal number."""
    count = int(np.clip(len(spin) // _LEAST_IN_BIN, 1, _BINS))
    order = np.argsort(spin, kind="stable")
    return [np.sort(part) for part in np.array_split(order, count)]


def _floor(problem: Problem, node: NodeData) -> Array:
    """(6,) below which no noise is believed: a hundredth of the declared one."""
    noise = problem.model.noise
    return 0.01 * np.array([noise.gyro] * 3 + [noise.accel] * 3)
