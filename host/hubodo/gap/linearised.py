"""The model linearised about one state: all that the data say about moving away from it, in matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.clock import follow_clocks
from hubodo.gap.noise import channel_noise
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.sensitivity import Direction, attitude_columns, columns
from hubodo.gap.state import State, predict, stacked
from hubodo.gap.wander import Columns, Weights, wandering
from hubodo.gap.wheel_phase import follow, on_samples, smoothed

_FOLLOWED = 2
_ROUNDING = 1e-5


@dataclass(frozen=True)
class Linearised:
    """directions: as asked; after them come nuisances, always free. blocks: (B, D+1, D+1), a gram for each
    stretch of time, the last row the residual's. logs: their logarithms."""

    state: State
    directions: tuple[Direction, ...]
    nuisances: int
    blocks: Array
    raw: Array
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
    walks = {node.name: declared_walk(problem, node) for node in problem.nodes if node.on_wheel}
    for _ in range(_FOLLOWED):
        if problem.model.inputs.clock_sigma > 0.0 and (state.paths or not walks):
            state = replace(state, late=follow_clocks(problem, state, walks))
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
    across, along = 0.5 * node.forward.track_width * problem.yaw_rate_noise, problem.speed_noise
    both = along**2 * problem.speed_period + across**2 * problem.yaw_rate_period
    return max(both / node.forward.wheel_radius**2, 1e-10)


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
    everything = columns(problem, state, directions)
    readings = predict(problem, state)
    bodies = [node for node in problem.nodes if not node.on_wheel]
    nuisances = 3 * len(bodies)
    own = {}
    for node in problem.nodes:
        felt = [
            k for k in range(len(directions)) if problem.measured_by or directions[k].node in ("", node.name)
        ]
        made = everything[node.name][felt]
        if not node.on_wheel:
            made = np.concatenate([made, attitude_columns(problem, node, state).astype(np.float32)])
            first = len(directions) + 3 * bodies.index(node)
            felt += range(first, first + 3)
        own[node.name] = Columns(made, felt)
    found = wandering(problem, state, readings, weights, own, len(directions) + nuisances)
    return Linearised(state, tuple(directions), nuisances, found.grams, found.raw, found.logs)


def solved(inner: Array, raw: Array) -> Array:
    """The inverse of information, (k, k), where there is any; zero for coordinates that are frozen.

    What is left of a column, raw: (k,), once walks and other columns are taken out may be rounding alone. The
    coordinates that say most go first (Cholesky with pivots), and what the others then do not see is frozen.
    """
    left, seen = inner.copy(), list[int]()
    for _ in range(len(raw)):
        worth = np.diag(left) * (np.diag(left) > _ROUNDING * np.maximum(raw, 1e-12))
        worth[seen] = 0.0
        first = int(np.argmax(worth))
        if worth[first] <= 0.0:
            break
        seen.append(first)
        left -= np.outer(left[first], left[first]) / left[first, first]
    covariance = np.zeros_like(inner)
    covariance[np.ix_(seen, seen)] = np.linalg.inv(inner[np.ix_(seen, seen)])
    return covariance
