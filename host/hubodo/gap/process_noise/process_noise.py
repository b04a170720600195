"""What wanders at random beside a model: angles of wheels, clocks, drift of gyros, noise of the inputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.wheel_phase import WINDOW
from hubodo.gap.process_noise.window_sums import Walk
from hubodo.gap.state.state import State
from hubodo.vehicle import side_sign

# s in which a clock that is corrected again and again wanders by as much as it is off.
_CLOCK_WANDERS = 10.0


@dataclass(frozen=True)
class Felt:
    """What one node feels of a walk.

    Its place among all, (6, N) change of the channels, (N,) where it was thought to be.
    """

    place: int
    answer: Array
    path: Array | float = 0.0


@dataclass(frozen=True)
class ProcessNoise:
    """walks: everything that wanders. felt: what each node feels of them, by its name."""

    walks: Sequence[Walk]
    felt: Mapping[str, Sequence[Felt]]


def process_noise(state: State, wheel_walks: Mapping[str, float]) -> ProcessNoise:
    """What wanders beside the model at a state. wheel_walks: rad²/s, of the angle of each wheel."""
    walks: list[Walk] = []
    felt: dict[str, list[Felt]] = {node.name: [] for node in state.problem.nodes}
    for walk, answers in _input_noise(state):
        for name, answer in answers.items():
            felt[name].append(Felt(len(walks), answer))
        walks.append(walk)
    for node in state.problem.nodes:
        if node.on_wheel:
            path = state.paths.get(node.name, 0.0)
            felt[node.name].append(Felt(len(walks), state.phase_columns[node.name], path))
            walks.append(Walk(wheel_walks[node.name]))
        for walk, answer, path in _own(state, node):
            felt[node.name].append(Felt(len(walks), answer, path))
            walks.append(walk)
    return ProcessNoise(walks, felt)


def _own(state: State, node: NodeData) -> Iterator[tuple[Walk, Array, Array | float]]:
    """What wanders in one node beside its wheel: walk, answer, and where it was thought to be."""
    if state.problem.model.inputs.clock_sigma > 0.0:
        yield clock_walk(state.problem), state.late_columns[node.name], state.late.get(node.name, 0.0)
    drift = sum(effect.drift() for effect in state.effects[node.name].values())
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


def _input_noise(state: State) -> Iterator[tuple[Walk, dict[str, Array]]]:
    """The noise of the samples of the inputs, as it is left in the mean and in the slope of a window.

    White noise of n samples leaves 1/n of its variance in their mean and 12/(n T²) in their slope; the same
    for all nodes. It turns a wheel within the window, too; how far from one window to the next is a walk.
    """
    grid = window_grid(state.problem)
    speeds, yaws = [], []
    for node in state.problem.nodes:
        answers = state.input_answers(node)
        at = node.t - (grid[window_of(grid, node)] + 0.5 * WINDOW)
        bent = 0.5 * (at**2 - WINDOW**2 / 12.0)
        phase = state.phase_columns.get(node.name, np.zeros(1)) / node.forward.wheel_radius
        y = side_sign(node.mount.side or "left") * node.forward.track_width / 2.0
        speeds.append((answers.speed + at * phase, at * answers.speed + answers.acceleration + bent * phase))
        yaws.append((answers.yaw_rate - y * at * phase, at * answers.yaw_rate - y * bent * phase))
    names = [node.name for node in state.problem.nodes]
    for variance, felt in zip(window_variances(state.problem), (speeds, yaws), strict=True):
        if variance > 0.0:
            level, slope = zip(*felt, strict=True)
            yield Walk(0.0, variance, white=True), dict(zip(names, level, strict=True))
            yield Walk(0.0, 12.0 * variance / WINDOW**2, white=True), dict(zip(names, slope, strict=True))


def window_grid(problem: Problem) -> Array:
    """(K,) s, where each window begins."""
    first = min(node.t[0] for node in problem.nodes)
    last = max(node.t[-1] for node in problem.nodes)
    return np.arange(first, last, WINDOW)


def window_of(grid: Array, node: NodeData) -> NDArray[np.intp]:
    """(N,): in which window each sample of a node is."""
    return np.clip(np.searchsorted(grid, node.t, side="right") - 1, 0, None)
