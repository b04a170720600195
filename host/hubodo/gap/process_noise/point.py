"""One point of the search: a state and the weights it is judged with, and what is left of the data there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.innovations import Innovations, innovations
from hubodo.gap.process_noise.parts import (
    BLOCK,
    Part,
    parts,
    window_edges,
    window_grid,
    window_means,
    window_of,
)
from hubodo.gap.process_noise.process_noise import Wandering, answers, felt, process_noise, window_variances
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.weights import Weights
from hubodo.gap.process_noise.wheel_phase import WINDOW
from hubodo.gap.process_noise.window_sums import Share, bounds
from hubodo.gap.state.noise import input_noise, sensor_noise
from hubodo.gap.state.state import State


class Columns(Protocol):
    """Columns of all nodes. at: for each node (P,) places of its own among all."""

    at: Mapping[str, Sequence[int]]

    def of(self, node: NodeData, state: State, samples: Mapping[str, slice]) -> Array:
        """(P, 6, N) of some samples of a node. node, state: of those samples alone."""
        ...


@dataclass(frozen=True)
class Wandered:
    """What a node did with something that wanders, in a stretch of time.

    answer: (6, N) per unit of it. mean: (N,) where it is beside its path, as all windows show it.
    """

    node: str
    samples: slice
    wandering: Wandering
    answer: Array
    mean: Array


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

    def innovations(self, columns: Columns | None, size: int, smooth: bool = False) -> Innovations:
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
        )

    def _shares(self, wanderings: Sequence[Wandering], columns: Columns | None) -> Iterator[Iterator[Share]]:
        wild = {node.name: bounds(self._z(node, slice(None))) for node in self.problem.nodes}
        for part in parts(self.problem):
            yield self._in_part(part, wanderings, columns, wild)

    def _in_part(
        self,
        part: Part,
        wanderings: Sequence[Wandering],
        columns: Columns | None,
        wild: Mapping[str, Array],
    ) -> Iterator[Share]:
        state = self.state.part(part.samples)
        for whole, node in zip(self.problem.nodes, state.problem.nodes, strict=True):
            samples, bound = part.samples[node.name], wild[node.name]
            made = np.zeros((0, *node.y.shape), np.float32)
            yield Share(
                part.edges[node.name],
                made if columns is None else columns.of(node, state, part.samples),
                () if columns is None else columns.at[node.name],
                np.clip(self._z(whole, samples), -bound, bound),
                self._weight(whole, samples),
                answers(state, node, wanderings, part.begins),
                felt(wanderings, node),
            )

    def _weight(self, node: NodeData, samples: slice) -> Array:
        noise = self.weights.noise[node.name]
        return np.asarray(noise.fresh[samples] * node.used[:, None] / noise.found[:, samples])

    def _z(self, node: NodeData, samples: slice) -> Array:
        """(6, N) residual of some samples, in sigma."""
        return np.asarray(self.state.residuals[node.name][:, samples] * self._weight(node, samples))

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
        """All that wanders, in each node, in one stretch of time after the other."""
        wanderings, grid = process_noise(self.state, self.weights.walks), window_grid(self.problem)
        mean = self.innovations(None, 0, smooth=True).mean
        for part in parts(self.problem):
            state = self.state.part(part.samples)
            for node in state.problem.nodes:
                inside = window_of(grid, node.t)
                made = answers(state, node, wanderings, part.begins)
                for place, answer in zip(felt(wanderings, node), made, strict=True):
                    along, white = mean[:, place], wanderings[place].walk.white
                    there = along[inside] if white else np.interp(node.t, grid + 0.5 * WINDOW, along)
                    yield Wandered(node.name, part.samples[node.name], wanderings[place], answer, there)

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
        for it in self.wandered():
            beside = of_inputs if it.wandering.walk.white else walked
            beside[it.node][:, it.samples] += it.answer * it.mean
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
