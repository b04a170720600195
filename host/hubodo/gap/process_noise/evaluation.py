"""Evaluation of a state under given weights: innovations, residuals and estimated process noise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.innovations import Innovations, filter_innovations
from hubodo.gap.process_noise.process_noise import (
    ProcessNoise,
    compute_noise_columns,
    input_window_variances,
    list_process_noise,
    noise_indices,
    shared_walk_covariance,
)
from hubodo.gap.process_noise.residual import Residual, WalkSteps
from hubodo.gap.process_noise.segments import (
    BLOCK_WINDOWS,
    Segment,
    find_standing_windows,
    split_segments,
    window_edges,
    window_grid,
    window_indices,
    window_means,
)
from hubodo.gap.process_noise.weights import Weights
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION
from hubodo.gap.process_noise.window_sums import NodeSegment, Whitening, winsor_limits, winsorise
from hubodo.gap.state.noise import declared_input_sigma, declared_sensor_sigma
from hubodo.gap.state.state import State


class NodeColumns(Protocol):
    """Sensitivity columns of all nodes.

    indices: for each node the positions of its P columns among all columns
    """

    @property
    def indices(self) -> Mapping[str, Sequence[int]]: ...

    def columns(self, node: NodeData, state: State, samples: Mapping[str, slice]) -> NDArray[np.float32]:
        """Return the columns of a node, (P, 6, N).

        node, state: restricted to the given samples
        """
        ...


@dataclass(frozen=True)
class NodeNoiseEstimate:
    """Estimated process noise of a node in one segment.

    node, state: restricted to the samples of the segment
    samples: slice of the log that the segment covers
    components: each process noise with the change of the channels per unit, (6, N), and its smoothed value
        relative to the tracked one, (N,)
    """

    node: NodeData
    state: State
    samples: slice
    components: Sequence[tuple[ProcessNoise, Array, Array]]


@dataclass(frozen=True)
class Evaluation:
    """A state and the weights of its residuals; results are computed once, on first use."""

    state: State
    weights: Weights

    @property
    def problem(self) -> Problem:
        return self.state.problem

    def with_state(self, state: State) -> Evaluation:
        """Return the evaluation of another state under the same weights."""
        return replace(self, state=state)

    def without_cache(self) -> Evaluation:
        """Return a copy without cached results, which take much memory for a long log."""
        return Evaluation(replace(self.state), self.weights)

    def compute_innovations(
        self, columns: NodeColumns | None, n_columns: int, smooth: bool = False
    ) -> Innovations:
        """Return the innovations of all nodes and their columns (`n_columns` in total).

        columns: sensitivity columns, None for the residual alone
        smooth: True to include the smoothed walks
        """
        noises = self._noises
        return filter_innovations(
            self._node_segments(noises, columns),
            [noise.walk for noise in noises],
            self._tracked_values(noises),
            n_columns,
            WINDOW_DURATION,
            BLOCK_WINDOWS,
            smooth,
            shared_walk_covariance(self.problem, noises),
        )

    def samples_per_block(self) -> Array:
        """Return how many readings of each channel take part in each block of windows, (B, C)."""
        return self._sum_blocks({n.name: self.weigh(n) > 0.0 for n in self.problem.nodes})

    def squares_per_block(self) -> Array:
        """Return the squares of the residuals, in sigma, in each block of windows and channel, (B, C)."""
        residuals = self.mean_residuals
        return self._sum_blocks(
            {
                node.name: winsorise(residuals[node.name].value * self.weigh(node)) ** 2
                for node in self.problem.nodes
            }
        )

    def _sum_blocks(self, values: Mapping[str, Array | NDArray[np.bool_]]) -> Array:
        """Return the sums of values of each node, (6, N), over blocks of windows, (B, C)."""
        edges = np.append(window_grid(self.problem)[::BLOCK_WINDOWS], np.inf)
        sums = []
        for node in self.problem.nodes:
            block = np.maximum(np.searchsorted(edges, node.t, side="right") - 1, 0)
            sums += [np.bincount(block, channel, len(edges) - 1) for channel in values[node.name]]
        return np.array(sums, float).T

    def _node_segments(
        self, noises: Sequence[ProcessNoise], columns: NodeColumns | None
    ) -> Iterator[Iterator[NodeSegment]]:
        limits = {
            node.name: winsor_limits(self.state.residual(node) * self.weigh(node))
            for node in self.problem.nodes
        }
        for segment in split_segments(self.problem):
            yield self._in_segment(segment, noises, columns, limits)

    def _in_segment(
        self,
        segment: Segment,
        noises: Sequence[ProcessNoise],
        columns: NodeColumns | None,
        limits: Mapping[str, Array],
    ) -> Iterator[NodeSegment]:
        state = self.state.select(segment.samples)
        for full_node, node in zip(self.problem.nodes, state.problem.nodes, strict=True):
            samples, limit = segment.samples[node.name], limits[node.name]
            no_columns = np.zeros((0, *node.y.shape), np.float32)
            correlation = self.weights.correlations.get(node.name)
            weight, whitening = self.weigh(full_node, samples), None
            if correlation is not None:
                is_standing = find_standing_windows(node, segment.edges[node.name])
                whitening = Whitening(correlation.whitening, is_standing)
            yield NodeSegment(
                segment.edges[node.name],
                no_columns if columns is None else columns.columns(node, state, segment.samples),
                () if columns is None else columns.indices[node.name],
                winsorise(state.residual(node) * weight, limit),
                weight,
                compute_noise_columns(state, node, noises, segment.window_starts),
                noise_indices(noises, node),
                whitening,
            )

    def weigh(self, node: NodeData, samples: slice = slice(None)) -> Array:
        """Return 1/sigma, (6, n), of a node's channels at some samples, 0 for excluded ones."""
        noise = self.weights.noise[node.name]
        is_used = noise.is_new[samples] * node.used[:, None] * ~node.is_saturated[:, samples]
        return np.asarray(is_used / noise.sigma_at(samples))

    def _tracked_values(self, noises: Sequence[ProcessNoise]) -> Array:
        """Return the tracked value of each process noise in each window, (C, K)."""
        grid, nodes = window_grid(self.problem), {node.name: node for node in self.problem.nodes}
        values = np.zeros((len(noises), len(grid)))
        for row, noise in zip(values, noises, strict=True):
            tracked = noise.tracked_value(self.state)
            if noise.node and np.any(tracked):
                node = nodes[noise.node]
                row[:] = window_means(np.broadcast_to(tracked, node.t.shape), window_edges(grid, node))
        return values

    def estimate_process_noise(self) -> Iterator[NodeNoiseEstimate]:
        """Yield the smoothed process noise of each node, one segment after the other."""
        noises, grid, smoothed = self._noises, window_grid(self.problem), self._smoothed_walks
        for segment in split_segments(self.problem):
            state = self.state.select(segment.samples)
            for node in state.problem.nodes:
                windows, components = window_indices(grid, node.t), []
                columns = compute_noise_columns(state, node, noises, segment.window_starts)
                for index, column in zip(noise_indices(noises, node), columns, strict=True):
                    if noises[index].slow_noise is not None:
                        # Noise of the sensor is a part of the residual.
                        continue
                    series, is_white = smoothed[:, index], noises[index].walk.is_white
                    value = (
                        series[windows]
                        if is_white
                        else np.interp(node.t, grid + 0.5 * WINDOW_DURATION, series)
                    )
                    components.append((noises[index], column, value))
                yield NodeNoiseEstimate(node, state, segment.samples[node.name], components)

    @property
    def _noises(self) -> list[ProcessNoise]:
        return list_process_noise(self.state, self.weights)

    @cached_property
    def _smoothed_walks(self) -> Array:
        """Return the smoothed process noise in each window, (K, C), relative to the tracked values."""
        return self.compute_innovations(None, 0, smooth=True).smoothed

    def _walk_steps(self, node: NodeData) -> WalkSteps:
        """Return the steps of the smoothed random walks of one node."""
        noises, grid = self._noises, window_grid(self.problem)
        walks = self._smoothed_walks.T + self._tracked_values(noises)
        steps = [
            (walk[1:] - noise.walk.decay(WINDOW_DURATION) * walk[:-1]) / math.sqrt(growth)
            for noise, walk in zip(noises, walks, strict=True)
            if noise.node == node.name
            and noise.slow_noise is None
            and (growth := noise.walk.growth(WINDOW_DURATION)) > 0.0
        ]
        first_samples = np.minimum(window_edges(grid, node)[1:-1], len(node.t) - 1)
        return WalkSteps(np.array(steps).reshape(-1, len(first_samples)), first_samples)

    @cached_property
    def residuals(self) -> Mapping[str, Residual]:
        """Return the residual of each node against the full model, including effects on scatter."""
        return {name: self._with_scatter(one) for name, one in self.mean_residuals.items()}

    @property
    def mean_residuals(self) -> Mapping[str, Residual]:
        """Return the residual of each node against the predicted mean, ignoring effects on scatter."""
        return self._residuals_and_input_noise[0]

    @property
    def input_noise_residuals(self) -> Mapping[str, Array]:
        """Return the part of the mean residuals, (6, N) per node, due to noise of the inputs."""
        return self._residuals_and_input_noise[1]

    @cached_property
    def _residuals_and_input_noise(self) -> tuple[Mapping[str, Residual], Mapping[str, Array]]:
        problem, nodes = self.problem, self.problem.nodes
        values = {node.name: self.state.residual(node) for node in nodes}
        input_noise = {node.name: np.zeros_like(node.y) for node in nodes}
        sigmas = {node.name: np.empty_like(node.y) for node in nodes}
        squares = {node.name: np.zeros((2, 6)) for node in nodes}
        for estimate in self.estimate_process_noise():
            name, at = estimate.node.name, estimate.samples
            for noise, column, mean in estimate.components:
                if noise.walk.is_white:
                    input_noise[name][:, at] += column * mean
                else:
                    values[name][:, at] -= column * mean
            sensitivity = estimate.state.input_sensitivity(estimate.node)
            sigmas[name][:, at] = declared_input_sigma(problem, sensitivity)
            squares[name] += (sensitivity.speed**2).sum(axis=1), (sensitivity.yaw_rate**2).sum(axis=1)
        self.state.drop_columns()
        residuals = {}
        for node in nodes:
            speed, yaw_rate = (
                np.array(input_window_variances(problem))[:, None] * squares[node.name] / len(node.t)
            )
            residuals[node.name] = Residual(
                node,
                values[node.name],
                declared_sensor_sigma(problem),
                self.weights.noise[node.name],
                sigmas[node.name],
                speed + yaw_rate,
                self.state.effects[node.name],
                self._walk_steps(node),
            )
        return residuals, input_noise

    def _with_scatter(self, mean: Residual) -> Residual:
        value = mean.value
        if BY_NAME["sample_repeat"] in mean.effects:
            fresh = mean.noise.is_new
            before = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))
            value = mean.node.y - mean.predicted[:, before]
        return replace(
            mean, value=value, sensor_sigma=declared_sensor_sigma(self.problem, mean.effects.values())
        )
