"""One point of the search: a state and the weights it is judged with, and what is left of the data there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.innovations import Innovations, innovations
from hubodo.gap.process_noise.process_noise import (
    Felt,
    ProcessNoise,
    process_noise,
    window_grid,
    window_of,
    window_variances,
)
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.weights import Weights
from hubodo.gap.process_noise.wheel_phase import WINDOW
from hubodo.gap.process_noise.window_sums import Share, Walk
from hubodo.gap.state.noise import input_noise, sensor_noise
from hubodo.gap.state.state import State

# Windows over which scores are added up: longer than what is left of any correlation.
BLOCK = 8


@dataclass(frozen=True)
class NodeColumns:
    """Columns of one node, (P, 6, N), and their places among all, (P,)."""

    made: Array
    at: Sequence[int]


@dataclass(frozen=True)
class Point:
    """A state and the weights it is judged with; what follows is worked out once, when it is asked for."""

    state: State
    weights: Weights

    @property
    def problem(self) -> Problem:
        return self.state.problem

    def at(self, state: State) -> Point:
        """The point of another state, judged alike."""
        return replace(self, state=state)

    def bare(self) -> Point:
        """Without what was worked out: for keeping, as a state of a long log takes much memory."""
        return Point(replace(self.state), self.weights)

    def innovations(self, columns: Iterable[tuple[NodeData, NodeColumns]], size: int) -> Innovations:
        """Of all nodes, and of their columns; size: of those in all."""
        noise = process_noise(self.state, self.weights.walks)
        return innovations(self._shares(noise, columns), noise.walks, size, WINDOW, BLOCK)

    def _shares(
        self, noise: ProcessNoise, columns: Iterable[tuple[NodeData, NodeColumns]]
    ) -> Iterator[Share]:
        for node, own in columns:
            share = self._share(node, noise, own)
            del own
            yield share
            del share

    def smoothed(self) -> Iterator[tuple[NodeData, Felt, Walk, Array]]:
        """For each walk that a node feels, (N,) where it is beside its path, as all windows show it."""
        noise, grid = process_noise(self.state, self.weights.walks), window_grid(self.problem)
        shares = []
        for node in self.problem.nodes:
            none = NodeColumns(np.zeros((0, *node.y.shape), np.float32), ())
            shares.append(self._share(node, noise, none))
        mean = innovations(shares, noise.walks, 0, WINDOW, BLOCK, smooth=True).mean
        for node in self.problem.nodes:
            inside = window_of(grid, node)
            for one in noise.felt[node.name]:
                walk, along = noise.walks[one.place], mean[:, one.place]
                if walk.white:
                    yield node, one, walk, along[inside]
                else:
                    yield node, one, walk, np.interp(node.t, grid + 0.5 * WINDOW, along)

    @cached_property
    def residuals(self) -> Mapping[str, Residual]:
        """Of each node, beside all that the model says: stale samples and noisy effects, too."""
        return {name: self._with_scatter(one) for name, one in self.mean_residuals.items()}

    @cached_property
    def mean_residuals(self) -> Mapping[str, Residual]:
        """Of each node, beside the mean that the model predicts, whatever it says about scatter."""
        state, problem = self.state, self.problem
        walked = {node.name: np.zeros_like(node.y) for node in problem.nodes}
        of_inputs = {node.name: np.zeros_like(node.y) for node in problem.nodes}
        for node, felt, walk, mean in self.smoothed():
            beside = of_inputs if walk.white else walked
            beside[node.name] += felt.answer * mean
        speed, yaw_rate = window_variances(problem)
        made = {}
        for node in problem.nodes:
            answers = state.input_answers(node)
            input_sigma = input_noise(problem, answers)
            made[node.name] = Residual(
                node,
                state.residuals[node.name] - walked[node.name],
                np.hypot(sensor_noise(problem), input_sigma),
                self.weights.noise[node.name],
                input_sigma,
                of_inputs[node.name],
                speed * np.mean(answers.speed**2, axis=1) + yaw_rate * np.mean(answers.yaw_rate**2, axis=1),
                state.effects[node.name],
            )
        return made

    def _with_scatter(self, mean: Residual) -> Residual:
        predicted = mean.predicted
        if BY_NAME["sample_repeat"] in mean.effects:
            fresh = mean.noise.fresh
            predicted = predicted[:, np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))]
        declared = np.hypot(sensor_noise(self.problem, mean.effects.values()), mean.input_sigma)
        return replace(mean, value=mean.node.y - predicted, declared=declared)

    def _share(self, node: NodeData, process: ProcessNoise, own: NodeColumns) -> Share:
        noise, felt = self.weights.noise[node.name], process.felt[node.name]
        edges = np.append(np.searchsorted(node.t, window_grid(self.problem)), len(node.t))
        return Share(
            edges,
            own.made,
            own.at,
            self.state.residuals[node.name],
            noise.fresh * node.used[:, None] / noise.found,
            np.array([one.answer for one in felt]).reshape(-1, *node.y.shape),
            [one.place for one in felt],
            np.array([_means(np.broadcast_to(one.path, node.t.shape), edges) for one in felt]),
        )


def _means(value: Array, edges: NDArray[np.intp]) -> Array:
    """(K,) mean in each window; where there are no samples, as before and after."""
    count = np.diff(edges)
    total = np.diff(np.concatenate([[0.0], np.cumsum(value)])[edges])
    at = np.arange(len(count))
    return np.asarray(np.interp(at, at[count > 0], total[count > 0] / count[count > 0]))
