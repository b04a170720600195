"""One point of the search: a state and the weights it is judged with, and what is left of the data there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.innovations import Innovations, innovations
from hubodo.gap.process_noise.parts import (
    BLOCK,
    Stretch,
    parts,
    window_edges,
    window_grid,
    window_means,
    window_of,
)
from hubodo.gap.process_noise.process_noise import (
    Wandering,
    answers,
    felt,
    process_noise,
    shared_steps,
    window_variances,
)
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.weights import Weights
from hubodo.gap.process_noise.wheel_phase import WINDOW
from hubodo.gap.process_noise.window_sums import Share, bounds
from hubodo.gap.state.noise import input_noise, sensor_noise
from hubodo.gap.state.state import State


class NodeColumns(Protocol):
    """Columns of all nodes. at: for each node (P,) places of its own among all."""

    @property
    def at(self) -> Mapping[str, Sequence[int]]: ...

    def of(self, node: NodeData, state: State, samples: Mapping[str, slice]) -> NDArray[np.float32]:
        """(P, 6, N) of some samples of a node. node, state: of those samples alone."""
        ...


@dataclass(frozen=True)
class Wandered:
    """What a node did with all that wanders, in a stretch of time.

    node, state: of some samples alone. made: what wanders; (6, N) of the channels per unit of it; and (N,)
    where it is beside its path, as all windows show it.
    """

    node: NodeData
    state: State
    samples: slice
    made: Sequence[tuple[Wandering, Array, Array]]


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

    def innovations(self, columns: NodeColumns | None, size: int, smooth: bool = False) -> Innovations:
        """Of all nodes, and of their columns; size: of those in all. smooth: see there."""
        wanderings = process_noise(self.state, self.weights.walks)
        return innovations(
            self._shares(wanderings, columns),
            [it.walk for it in wanderings],
            self._paths(wanderings),
            size,
            WINDOW,
            BLOCK,
            smooth,
            shared_steps(self.problem, wanderings),
        )

    def _shares(
        self, wanderings: Sequence[Wandering], columns: NodeColumns | None
    ) -> Iterator[Iterator[Share]]:
        wild = {
            node.name: bounds(self.state.residual(node) * self._weight(node, slice(None)))
            for node in self.problem.nodes
        }
        for part in parts(self.problem):
            yield self._in_part(part, wanderings, columns, wild)

    def _in_part(
        self,
        part: Stretch,
        wanderings: Sequence[Wandering],
        columns: NodeColumns | None,
        wild: Mapping[str, Array],
    ) -> Iterator[Share]:
        state = self.state.part(part.samples)
        for whole, node in zip(self.problem.nodes, state.problem.nodes, strict=True):
            samples, bound = part.samples[node.name], wild[node.name]
            made = np.zeros((0, *node.y.shape), np.float32)
            weight = self._weight(whole, samples)
            yield Share(
                part.edges[node.name],
                made if columns is None else columns.of(node, state, part.samples),
                () if columns is None else columns.at[node.name],
                np.clip(state.residual(node) * weight, -bound, bound),
                weight,
                answers(state, node, wanderings, part.begins),
                felt(wanderings, node),
            )

    def _weight(self, node: NodeData, samples: slice) -> Array:
        noise = self.weights.noise[node.name]
        worth = noise.fresh[samples] * node.used[:, None] * ~node.clipped[:, samples]
        return np.asarray(worth / noise.part(samples))

    def _paths(self, wanderings: Sequence[Wandering]) -> Array:
        """(C, K) where each that wanders was thought to be in each window."""
        grid, nodes = window_grid(self.problem), {node.name: node for node in self.problem.nodes}
        made = np.zeros((len(wanderings), len(grid)))
        for into, it in zip(made, wanderings, strict=True):
            path = it.path(self.state)
            if it.node and np.any(path):
                node = nodes[it.node]
                into[:] = window_means(np.broadcast_to(path, node.t.shape), window_edges(grid, node))
        return made

    def wandered(self) -> Iterator[Wandered]:
        """Of each node, in one stretch of time after the other."""
        wanderings, grid = process_noise(self.state, self.weights.walks), window_grid(self.problem)
        mean = self.innovations(None, 0, smooth=True).mean
        for part in parts(self.problem):
            state = self.state.part(part.samples)
            for node in state.problem.nodes:
                inside, made = window_of(grid, node.t), []
                moved = answers(state, node, wanderings, part.begins)
                for place, answer in zip(felt(wanderings, node), moved, strict=True):
                    along, white = mean[:, place], wanderings[place].walk.white
                    there = along[inside] if white else np.interp(node.t, grid + 0.5 * WINDOW, along)
                    made.append((wanderings[place], answer, there))
                yield Wandered(node, state, part.samples[node.name], made)

    @cached_property
    def residuals(self) -> Mapping[str, Residual]:
        """Of each node, beside all that the model says: stale samples and noisy effects, too."""
        return {name: self._with_scatter(one) for name, one in self.mean_residuals.items()}

    @property
    def mean_residuals(self) -> Mapping[str, Residual]:
        """Of each node, beside the mean that the model predicts, whatever it says about scatter."""
        return self._beside_mean[0]

    @property
    def of_inputs(self) -> Mapping[str, Array]:
        """(6, N) of each node: what of the mean residuals the noise of the inputs may have made."""
        return self._beside_mean[1]

    @cached_property
    def _beside_mean(self) -> tuple[Mapping[str, Residual], Mapping[str, Array]]:
        problem, nodes = self.problem, self.problem.nodes
        values = {node.name: self.state.residual(node) for node in nodes}
        of_inputs = {node.name: np.zeros_like(node.y) for node in nodes}
        sigmas = {node.name: np.empty_like(node.y) for node in nodes}
        squares = {node.name: np.zeros((2, 6)) for node in nodes}
        for it in self.wandered():
            name, at = it.node.name, it.samples
            for wandering, answer, mean in it.made:
                if wandering.walk.white:
                    of_inputs[name][:, at] += answer * mean
                else:
                    values[name][:, at] -= answer * mean
            own = it.state.input_answers(it.node)
            sigmas[name][:, at] = input_noise(problem, own)
            squares[name] += (own.speed**2).sum(axis=1), (own.yaw_rate**2).sum(axis=1)
        self.state.forget_columns()
        made = {}
        for node in nodes:
            speed, yaw_rate = np.array(window_variances(problem))[:, None] * squares[node.name] / len(node.t)
            made[node.name] = Residual(
                node,
                values[node.name],
                sensor_noise(problem),
                self.weights.noise[node.name],
                sigmas[node.name],
                speed + yaw_rate,
                self.state.effects[node.name],
            )
        return made, of_inputs

    def _with_scatter(self, mean: Residual) -> Residual:
        value = mean.value
        if BY_NAME["sample_repeat"] in mean.effects:
            fresh = mean.noise.fresh
            before = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
            value = mean.node.y - mean.predicted[:, before]
        return replace(mean, value=value, sensor_sigma=sensor_noise(self.problem, mean.effects.values()))
