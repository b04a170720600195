"""The model linearised about one state: all that the data say about moving away from it, in matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hubodo.gap.innovations import Innovations, Walk, innovations
from hubodo.gap.noise import ChannelNoise, channel_noise
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.sensitivity import Direction, attitude_columns, columns, phase_column
from hubodo.gap.state import State, effects_of, predict, stacked
from hubodo.gap.wheel_phase import WINDOW, follow, on_samples, smoothed
from hubodo.model.forward import Reading
from hubodo.model.frames import Array

# Blocks of windows over which scores are added up: longer than what is left of any correlation.
_BLOCK = 8
_FOLLOWED = 2
_ROUNDING = 1e-5


@dataclass(frozen=True)
class Weights:
    """What residuals are weighed with: 1 sigma of channels by node, and the walk of each wheel, rad²/s."""

    noise: Mapping[str, ChannelNoise]
    walks: Mapping[str, float]


@dataclass(frozen=True)
class Linearised:
    """directions: as asked; after them come nuisances, always free. blocks: (B, D+1, D+1), a gram for each
    stretch of each node, the last row the residual's. t: (B,) s. logs: their logarithms."""

    state: State
    directions: tuple[Direction, ...]
    nuisances: int
    blocks: Array
    raw: Array
    t: Array
    logs: float

    @property
    def gram(self) -> Array:
        return np.asarray(self.blocks.sum(axis=0))

    @property
    def always(self) -> list[int]:
        """Indices of what is always free."""
        return list(range(len(self.directions), len(self.directions) + self.nuisances))


def settle(problem: Problem, state: State) -> tuple[State, dict[str, float]]:
    """The state with the path of each wheel followed anew, and how much each path wanders, rad²/s."""
    walks = {}
    for _ in range(_FOLLOWED):
        readings = predict(problem, state)
        paths = dict(state.paths)
        for node in problem.nodes:
            if node.on_wheel:
                phases = follow(node, readings[node.name], paths.get(node.name), _accel_noise(problem, node))
                path, walks[node.name] = smoothed(phases, declared_walk(problem, node))
                paths[node.name] = on_samples(node, phases, path)
        state = replace(state, paths=paths)
    return state, walks


def _accel_noise(problem: Problem, node: NodeData) -> float:
    """m/s²: as declared, or as the samples scatter where that is more."""
    return max(problem.model.noise.accel, node.accel_scatter)


def declared_walk(problem: Problem, node: NodeData) -> float:
    """rad²/s: how much a wheel's angle wanders when the noise of the inputs is integrated."""
    inputs, period = problem.model.inputs, problem.input_period
    across = 0.5 * node.forward.track_width * inputs.yaw_rate_noise
    per_sample = (inputs.speed_noise**2 + across**2) / node.forward.wheel_radius**2
    return max(per_sample * period, 1e-10)


def weights(problem: Problem, state: State, walks: Mapping[str, float]) -> Weights:
    """How the residual of a state is to be weighed."""
    readings = predict(problem, state)
    noise = {
        node.name: channel_noise(problem, node, readings[node.name], node.y - stacked(readings[node.name]))
        for node in problem.nodes
    }
    return Weights(noise, walks)


def linearise(
    problem: Problem, state: State, directions: Sequence[Direction], weights: Weights
) -> Linearised:
    """All that the data say about the directions, from this state."""
    made = columns(problem, state, directions)
    readings = predict(problem, state)
    bodies = [node for node in problem.nodes if not node.on_wheel]
    nuisances = 3 * len(bodies)
    total = len(directions) + nuisances + 1
    blocks, times, logs, raw = [], [], 0.0, np.zeros(total)
    for node in problem.nodes:
        felt = [
            k for k in range(len(directions)) if problem.measured_by or directions[k].node in ("", node.name)
        ]
        own = made[node.name][felt]
        at = list(felt)
        if not node.on_wheel:
            own = np.concatenate([own, attitude_columns(problem, node, state).astype(np.float32)])
            first = len(directions) + 3 * bodies.index(node)
            at += range(first, first + 3)
        at.append(total - 1)
        found = node_innovations(problem, node, state, own, readings[node.name], weights)
        starts = np.arange(0, len(found.t), _BLOCK)
        summed = np.add.reduceat(found.grams, starts, axis=0)
        wide = np.zeros((len(starts), total, total))
        wide[np.ix_(range(len(starts)), at, at)] = summed
        blocks.append(wide)
        times.append(found.t[starts])
        logs += float(found.logs.sum())
        raw[at] += found.raw
    whole = np.concatenate(blocks)
    return Linearised(state, tuple(directions), nuisances, whole, raw, np.concatenate(times), logs)


def node_innovations(
    problem: Problem, node: NodeData, state: State, own: Array, reading: Reading, weights: Weights
) -> Innovations:
    """The innovations of one node for its own columns, (P, 6, N)."""
    noise = weights.noise[node.name]
    weight = noise.fresh * node.used[:, None] / noise.found
    walks = []
    if node.on_wheel:
        path = np.broadcast_to(state.paths.get(node.name, np.zeros(1)), node.t.shape)
        walks.append(Walk(phase_column(problem, node, state), weights.walks[node.name], path))
    drift = sum(effect.drift() for effect in effects_of(problem, state.terms)[node.name].values())
    if drift > 0.0:
        for row in range(3):
            answer = np.zeros_like(node.y)
            answer[row] = 1.0
            walks.append(Walk(answer, drift, np.zeros(len(node.t)), start=drift * WINDOW))
    return innovations(node.t, own, node.y - stacked(reading), weight, walks)


def solved(inner: Array, raw: Array) -> Array:
    """The inverse of information, (k, k), where there is any.

    What is left of a column, raw: (k,), once walks and other columns are taken out may be rounding alone:
    such combinations are not moved, their covariance is zero.
    """
    size = np.sqrt(np.maximum(raw, 1e-12))
    values, vectors = np.linalg.eigh(inner / np.outer(size, size))
    seen = values > _ROUNDING
    half = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]
    covariance = half @ half.T
    # No coordinate is better known than alone and with nothing taken out, unless it was frozen.
    frozen = np.diag(covariance) * raw < 0.9
    covariance[frozen] = 0.0
    covariance[:, frozen] = 0.0
    return np.asarray(covariance)
