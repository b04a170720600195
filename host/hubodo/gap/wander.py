"""What wanders beside the model: angles of wheels, clocks, drift of gyros, and the noise of the inputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.innovations import Innovations, Share, Walk, innovations
from hubodo.gap.noise import ChannelNoise, input_answers
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.sensitivity import late_column, phase_column
from hubodo.gap.state import State, effects_of, stacked
from hubodo.gap.wheel_phase import WINDOW
from hubodo.model.forward import Reading, Start
from hubodo.vehicle import side_sign

# Blocks of windows over which scores are added up: longer than what is left of any correlation.
BLOCK = 8
# s in which a clock that is corrected again and again wanders by as much as it is off.
_CLOCK_WANDERS = 10.0


@dataclass(frozen=True)
class Weights:
    """What residuals are weighed with: 1 sigma of channels by node, and the walk of each wheel, rad²/s."""

    noise: Mapping[str, ChannelNoise]
    walks: Mapping[str, float]


@dataclass(frozen=True)
class Columns:
    """Columns of one node, (P, 6, N), and their places among all, (P,)."""

    made: Array
    at: Sequence[int]


@dataclass(frozen=True)
class Wandered:
    """How far a node reads beside the model, (6, N) each: for what walks, and for the noise of the inputs."""

    walks: Array
    inputs: Array


@dataclass(frozen=True)
class _Felt:
    """What one node feels of a walk: its place among all, (6, N) change of the channels, (N,) where it was
    thought to be."""

    place: int
    answer: Array
    path: Array | float = 0.0


def wandering(
    problem: Problem,
    state: State,
    readings: Mapping[str, Reading],
    weights: Weights,
    columns: Mapping[str, Columns],
    size: int,
) -> Innovations:
    """The innovations of all nodes, and of their columns; size: of those in all."""
    walks, felt = _walks(problem, state, readings, weights)
    shares = [
        _share(problem, node, readings[node.name], weights, felt[node.name], columns[node.name])
        for node in problem.nodes
    ]
    return innovations(shares, walks, size, WINDOW, BLOCK)


def wandered(
    problem: Problem, state: State, readings: Mapping[str, Reading], weights: Weights
) -> dict[str, Wandered]:
    """What wanders of each node beside the model, as all windows together show it."""
    made = {node.name: Wandered(np.zeros_like(node.y), np.zeros_like(node.y)) for node in problem.nodes}
    for node, one, walk, mean in _smoothed(problem, state, readings, weights):
        beside = made[node.name].inputs if walk.white else made[node.name].walks
        beside += one.answer * mean
    return made


def walked_late(
    problem: Problem, state: State, readings: Mapping[str, Reading], weights: Weights
) -> dict[str, Array]:
    """(N,) s: how much later the stamps of each node are than they are thought to be."""
    late = clock_walk(problem)
    return {
        node.name: mean
        for node, _, walk, mean in _smoothed(problem, state, readings, weights)
        if walk == late
    }


def _smoothed(
    problem: Problem, state: State, readings: Mapping[str, Reading], weights: Weights
) -> Iterator[tuple[NodeData, _Felt, Walk, Array]]:
    """For each walk that a node feels, (N,) where it is beside its path."""
    walks, felt = _walks(problem, state, readings, weights)
    grid = window_grid(problem)
    shares = []
    for node in problem.nodes:
        none = Columns(np.zeros((0, *node.y.shape), np.float32), ())
        shares.append(_share(problem, node, readings[node.name], weights, felt[node.name], none))
    mean = innovations(shares, walks, 0, WINDOW, BLOCK, smooth=True).mean
    for node in problem.nodes:
        inside = np.clip(np.searchsorted(grid, node.t, side="right") - 1, 0, None)
        for one in felt[node.name]:
            walk = walks[one.place]
            if walk.white:
                yield node, one, walk, mean[inside, one.place]
            else:
                yield node, one, walk, np.interp(node.t, grid + 0.5 * WINDOW, mean[:, one.place])


def window_grid(problem: Problem) -> Array:
    """(K,) s, where each window begins."""
    first = min(node.t[0] for node in problem.nodes)
    last = max(node.t[-1] for node in problem.nodes)
    return np.arange(first, last, WINDOW)


def _share(
    problem: Problem, node: NodeData, reading: Reading, weights: Weights, felt: Sequence[_Felt], own: Columns
) -> Share:
    noise = weights.noise[node.name]
    edges = _edges(problem, node)
    return Share(
        edges,
        own.made,
        own.at,
        node.y - stacked(reading),
        noise.fresh * node.used[:, None] / noise.found,
        np.array([one.answer for one in felt]).reshape(-1, *node.y.shape),
        [one.place for one in felt],
        np.array([_means(np.broadcast_to(one.path, node.t.shape), edges) for one in felt]),
    )


def _edges(problem: Problem, node: NodeData) -> NDArray[np.intp]:
    return np.append(np.searchsorted(node.t, window_grid(problem)), len(node.t))


def _means(value: Array, edges: NDArray[np.intp]) -> Array:
    """(K,) mean in each window; where there are no samples, as before and after."""
    count = np.diff(edges)
    total = np.diff(np.concatenate([[0.0], np.cumsum(value)])[edges])
    at = np.arange(len(count))
    return np.asarray(np.interp(at, at[count > 0], total[count > 0] / count[count > 0]))


def _walks(
    problem: Problem, state: State, readings: Mapping[str, Reading], weights: Weights
) -> tuple[list[Walk], dict[str, list[_Felt]]]:
    walks: list[Walk] = []
    felt: dict[str, list[_Felt]] = {node.name: [] for node in problem.nodes}
    phases = {node.name: phase_column(problem, node, state) for node in problem.nodes if node.on_wheel}
    for walk, answers in _input_noise(problem, state, readings, phases):
        for name, answer in answers.items():
            felt[name].append(_Felt(len(walks), answer))
        walks.append(walk)
    for node in problem.nodes:
        if node.on_wheel:
            path = state.paths.get(node.name, 0.0)
            felt[node.name].append(_Felt(len(walks), phases[node.name], path))
            walks.append(Walk(weights.walks[node.name]))
        for walk, answer, path in _own(problem, node, state):
            felt[node.name].append(_Felt(len(walks), answer, path))
            walks.append(walk)
    return walks, felt


def _own(problem: Problem, node: NodeData, state: State) -> Iterator[tuple[Walk, Array, Array | float]]:
    """What wanders in one node beside its wheel: walk, answer, and where it was thought to be."""
    if problem.model.inputs.clock_sigma > 0.0:
        yield clock_walk(problem), late_column(problem, node, state), state.late.get(node.name, 0.0)
    drift = sum(effect.drift() for effect in effects_of(problem, state.terms)[node.name].values())
    if drift > 0.0:
        for row in range(3):
            answer = np.zeros_like(node.y)
            answer[row] = 1.0
            yield Walk(drift, drift * WINDOW), answer, 0.0


def clock_walk(problem: Problem) -> Walk:
    """How late the stamps of a node are: off by clock_sigma at first, and slowly wandering by as much."""
    variance = problem.model.inputs.clock_sigma**2
    return Walk(variance / _CLOCK_WANDERS, variance)


def window_variances(problem: Problem) -> tuple[float, float]:
    """Of what the noise of the inputs leaves in a window's mean: (m/s)² and (rad/s)²."""
    speed = problem.speed_noise**2 * min(1.0, problem.speed_period / WINDOW)
    yaw_rate = problem.yaw_rate_noise**2 * min(1.0, problem.yaw_rate_period / WINDOW)
    return speed, yaw_rate


def _input_noise(
    problem: Problem, state: State, readings: Mapping[str, Reading], phases: Mapping[str, Array]
) -> Iterator[tuple[Walk, dict[str, Array]]]:
    """The noise of the samples of the inputs, as it is left in the mean and in the slope of a window.

    White noise of n samples leaves 1/n of its variance in their mean and 12/(n T²) in their slope; the same
    for all nodes. It turns a wheel within the window, too; how far from one window to the next is a walk.
    phases: (6, N) per rad, of nodes on wheels.
    """
    grid = window_grid(problem)
    speeds, yaws = [], []
    for node in problem.nodes:
        start = state.starts.get(node.name, Start())
        answers = input_answers(node, readings[node.name], start)
        inside = np.clip(np.searchsorted(grid, node.t, side="right") - 1, 0, None)
        at = node.t - (grid[inside] + 0.5 * WINDOW)
        bent = 0.5 * (at**2 - WINDOW**2 / 12.0)
        phase = phases.get(node.name, np.zeros(1)) / node.forward.wheel_radius
        y = 0.5 * side_sign(node.mount.side or "left") * node.forward.track_width
        speeds.append((answers.speed + at * phase, at * answers.speed + answers.acceleration + bent * phase))
        yaws.append((answers.yaw_rate - y * at * phase, at * answers.yaw_rate - y * bent * phase))
    names = [node.name for node in problem.nodes]
    for variance, felt in zip(window_variances(problem), (speeds, yaws), strict=True):
        if variance > 0.0:
            level, slope = zip(*felt, strict=True)
            yield Walk(0.0, variance, white=True), dict(zip(names, level, strict=True))
            yield Walk(0.0, 12.0 * variance / WINDOW**2, white=True), dict(zip(names, slope, strict=True))
