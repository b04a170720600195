"""Process noise of a model: wheel angles, clocks, gyro drift and the noise of the inputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.segments import window_indices
from hubodo.gap.process_noise.weights import Carrier, SlowNoise, Weights, shared_wheel_walk
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION
from hubodo.gap.process_noise.window_sums import RandomWalk
from hubodo.gap.state.state import State
from hubodo.vehicle import facing_sign, side_sign

# s, time in which a repeatedly corrected clock drifts by clock_sigma.
_CLOCK_WALK_TIME = 10.0

# m/s, lower bound of the mean speed; a vehicle that hardly moves cannot distinguish a bank from a bias.
_MIN_MEAN_SPEED = 0.1

# Largest correlation between the steps of two wheels: no two roll identically, and a nearly singular
# covariance would amplify rounding errors.
_MAX_WALK_CORRELATION = 0.9

NoiseSource = Literal[
    "speed",
    "speed slope",
    "yaw rate",
    "yaw rate slope",
    "yaw rate offset",
    "bank",
    "wheel",
    "clock",
    "gx",
    "gy",
    "gz",
    "slow noise",
]


@dataclass(frozen=True)
class ProcessNoise:
    """One source of process noise.

    node: name of the node on which it acts, "" for all nodes
    slow_noise: noise of a channel that the process describes, of the source of that name
    """

    walk: RandomWalk
    source: NoiseSource
    node: str = ""
    slow_noise: SlowNoise | None = None

    def tracked_value(self, state: State) -> Array | float:
        """Return the tracked value, (N,) at the samples of its node."""
        tracked = {"wheel": state.phase_offsets, "clock": state.stamp_delays}.get(self.source, {})
        return tracked.get(self.node, 0.0)


def list_process_noise(state: State, weights: Weights) -> list[ProcessNoise]:
    """Return the process noise of a state under some weights."""
    noises = list(_list_input_noise(state.problem))
    noises += [ProcessNoise(walk, "bank") for walk in _list_bank_walks(state)]
    for node in state.problem.nodes:
        if node.on_wheel:
            noises.append(ProcessNoise(RandomWalk(weights.wheel_walks[node.name]), "wheel", node.name))
        if state.problem.model.inputs.clock_sigma > 0.0:
            noises.append(ProcessNoise(stamp_delay_walk(state.problem), "clock", node.name))
        drift = sum(effect.random_walk_variance_rate() for effect in state.effects[node.name].values())
        if drift > 0.0:
            walk = RandomWalk(drift, drift * WINDOW_DURATION)
            noises += [ProcessNoise(walk, row, node.name) for row in ("gx", "gy", "gz")]
    for name, correlation in weights.correlations.items():
        for one in correlation.slow_noise:
            process = RandomWalk(0.0, one.sigma**2, correlation_time=one.correlation_time)
            noises.append(ProcessNoise(process, "slow noise", name, one))
    return noises


def shared_walk_covariance(problem: Problem, noises: Sequence[ProcessNoise]) -> Array:
    """Return the covariance per second, (C, C), between wheels that integrate the same inputs."""
    covariance = np.zeros((len(noises), len(noises)))
    nodes = {node.name: node for node in problem.nodes}
    wheels = [(k, nodes[noise.node]) for k, noise in enumerate(noises) if noise.source == "wheel"]
    for (k, wheel), (j, other) in permutations(wheels, 2):
        covariance[k, j] = _MAX_WALK_CORRELATION * shared_wheel_walk(problem, wheel, other)
    return covariance


def noise_indices(noises: Sequence[ProcessNoise], node: NodeData) -> list[int]:
    """Return the indices, (C,), of the process noise that acts on one node."""
    return [k for k, noise in enumerate(noises) if noise.node in ("", node.name)]


def compute_noise_columns(
    state: State, node: NodeData, noises: Sequence[ProcessNoise], window_starts: Array
) -> Array:
    """Return the change of a node's channels, (C, 6, N), per unit of each process noise that acts on it.

    window_starts: s, of the windows that contain its samples
    """
    indices = noise_indices(noises, node)
    columns = np.zeros((len(indices), *node.y.shape))
    input_columns = (
        _input_noise_columns(state, node, window_starts) if any(not noise.node for noise in noises) else {}
    )
    for column, index in zip(columns, indices, strict=True):
        source, slow_noise = noises[index].source, noises[index].slow_noise
        if slow_noise is not None:
            column[slow_noise.row] = compute_carrier(state, node, slow_noise.carrier)
        elif source == "wheel":
            column[:] = state.phase_columns[node.name]
        elif source == "clock":
            column[:] = state.delay_columns[node.name]
        elif source in input_columns:
            column[:] = input_columns[source]
        elif source == "bank":
            column[:] = bank_column(state, node)
        else:
            column[("gx", "gy", "gz").index(source)] = 1.0
    return columns


def compute_carrier(state: State, node: NodeData, carrier: Carrier) -> Array:
    """Return a wave of the wheel angle, (N,); a node on the body has the constant one alone."""
    rolling = state.predictions[node.name].rolling
    if carrier == "constant" or rolling is None:
        return np.ones(len(node.t))
    return np.asarray(np.cos(rolling.angle) if carrier == "cosine" else np.sin(rolling.angle))


def _list_bank_walks(state: State) -> Iterator[RandomWalk]:
    """Yield the process of a banked road, once for the vehicle; the mean speed converts length to time."""
    effects = state.effects[state.problem.nodes[0].name].values()
    for sigma, length in (effect.bank_process() for effect in effects):
        if sigma > 0.0:
            yield RandomWalk(0.0, sigma**2, correlation_time=length / mean_speed(state.problem.nodes[0]))


def mean_speed(node: NodeData) -> float:
    """Return the mean speed of the vehicle while a node sampled, m/s, at least 0.1."""
    return max(float(np.mean(np.abs(node.forward.inputs.at(node.t).speed))), _MIN_MEAN_SPEED)


def bank_column(state: State, node: NodeData) -> Array:
    """Return the change of a node's channels, (6, N), per rad of bank: gravity to the left."""
    column = np.zeros_like(node.y)
    if node.on_wheel:
        column[5] = facing_sign(node.mount.facing or "left") * STANDARD_GRAVITY
        return column
    left = Rotation.from_rotvec(state.start_of(node).attitude).inv().apply([0.0, STANDARD_GRAVITY, 0.0])
    column[3:] = left[:, None]
    return column


def stamp_delay_walk(problem: Problem) -> RandomWalk:
    """Return the random walk of a stamp delay: clock_sigma at the start, then a slow drift."""
    variance = problem.model.inputs.clock_sigma**2
    return RandomWalk(variance / _CLOCK_WALK_TIME, variance)


def input_window_variances(problem: Problem) -> tuple[float, float]:
    """Return the variances of a window's mean due to noise of the inputs: (m/s)² and (rad/s)²."""
    speed = problem.speed_noise**2 * min(1.0, problem.speed_period / WINDOW_DURATION)
    yaw_rate = problem.yaw_rate_noise**2 * min(1.0, problem.yaw_rate_period / WINDOW_DURATION)
    return speed, yaw_rate


def _list_input_noise(problem: Problem) -> Iterator[ProcessNoise]:
    """Yield the noise of the inputs' samples as mean and slope of a window.

    White noise of n samples leaves 1/n of its variance in their mean and 12/(n T²) in their slope, common to
    all nodes.
    """
    sources: tuple[tuple[NoiseSource, NoiseSource], ...] = (
        ("speed", "speed slope"),
        ("yaw rate", "yaw rate slope"),
    )
    for variance, (level, slope) in zip(input_window_variances(problem), sources, strict=True):
        if variance > 0.0:
            yield ProcessNoise(RandomWalk(0.0, variance, is_white=True), level)
            yield ProcessNoise(RandomWalk(0.0, 12.0 * variance / WINDOW_DURATION**2, is_white=True), slope)
    if problem.yaw_rate_offset_sigma > 0.0:
        yield ProcessNoise(RandomWalk(0.0, problem.yaw_rate_offset_sigma**2), "yaw rate offset")


def _input_noise_columns(state: State, node: NodeData, window_starts: Array) -> dict[NoiseSource, Array]:
    """Return the change of a node's channels, (6, N), per unit of mean and slope of each input's noise.

    The noise also turns the wheel within the window; its walk from window to window is modelled separately. A
    constant error turns the wheel from the start of the log on.
    """
    sensitivity = state.input_sensitivity(node)
    offset = node.t - (window_starts[window_indices(window_starts, node.t)] + 0.5 * WINDOW_DURATION)
    quadratic = 0.5 * (offset**2 - WINDOW_DURATION**2 / 12.0)
    phase = state.phase_columns.get(node.name, np.zeros(1)) / node.forward.wheel_radius
    y = side_sign(node.mount.side or "left") * node.forward.track_width / 2.0
    return {
        "speed": sensitivity.speed + offset * phase,
        "speed slope": offset * sensitivity.speed + sensitivity.acceleration + quadratic * phase,
        "yaw rate": sensitivity.yaw_rate - y * offset * phase,
        "yaw rate slope": offset * sensitivity.yaw_rate - y * quadratic * phase,
        "yaw rate offset": sensitivity.yaw_rate - y * (node.t - node.forward.inputs.yaw_rate.start) * phase,
    }
