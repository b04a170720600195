"""Weights of residuals: noise of each channel and random walk of each wheel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.state.noise import ChannelNoise, declared_sensor_sigma, estimate_channel_noise
from hubodo.gap.state.state import State
from hubodo.vehicle import side_sign

# rad²/s; lower bound of a wheel's walk, whatever noise is declared for the inputs.
_MIN_WHEEL_WALK = 1e-10


Carrier = Literal["constant", "cosine", "sine"]
"""Wave of the wheel angle that slow noise modulates: none, or one that turns with the wheel."""


@dataclass(frozen=True)
class SlowNoise:
    """Noise of one channel that lasts longer than a window: a Gauss-Markov process times a carrier.

    row: index of the channel
    sigma: 1 sigma of the process, in the unit of the channel
    correlation_time: s
    """

    row: int
    carrier: Carrier
    sigma: float
    correlation_time: float


@dataclass(frozen=True)
class NoiseCorrelation:
    """Correlation of the noise of one node.

    whitening: lower triangular matrices, (2, 6, M, M), that make the noise of each channel white within a
        window of up to M samples: of a wheel that turns, and of one that stands
    slow_noise: noise that is correlated from window to window, which `whitening` leaves out
    """

    whitening: Array
    slow_noise: tuple[SlowNoise, ...] = ()


@dataclass(frozen=True)
class Weights:
    """Weights of residuals.

    noise: noise of the channels of each node
    wheel_walks: rad²/s, intensity of the random walk of each wheel's angle
    correlations: of the nodes whose noise is not white
    """

    noise: Mapping[str, ChannelNoise]
    wheel_walks: Mapping[str, float]
    correlations: Mapping[str, NoiseCorrelation] = field(default_factory=dict)

    @property
    def is_correlated(self) -> bool:
        """Return True if the noise of any node is taken as correlated."""
        return bool(self.correlations)


def declared_weights(problem: Problem, walks: Mapping[str, float]) -> Weights:
    """Return weights with the noise declared in the model file."""
    noise = {}
    for node in problem.nodes:
        one_group, is_new = np.zeros(len(node.t), np.uint8), np.ones(len(node.t), bool)
        noise[node.name] = ChannelNoise(declared_sensor_sigma(problem), one_group, is_new)
    return Weights(noise, walks)


def weights_from_residuals(state: State, walks: Mapping[str, float]) -> Weights:
    """Return weights with noise estimated from the residuals of a state."""
    noise = {
        node.name: estimate_channel_noise(
            state.problem, node, state.predictions[node.name], state.residual(node)
        )
        for node in state.problem.nodes
    }
    return Weights(noise, walks)


def declared_wheel_walk(problem: Problem, node: NodeData) -> float:
    """Return the random walk of a wheel's angle, rad²/s, due to the integrated noise of the inputs."""
    return max(shared_wheel_walk(problem, node, node), _MIN_WHEEL_WALK)


def shared_wheel_walk(problem: Problem, one: NodeData, other: NodeData) -> float:
    """Return the covariance per second of two wheels' angles, rad²/s, due to noise of the inputs.

    A wheel at lateral position y turns by the integral of (speed - y · yaw rate) / radius.
    """
    along = problem.speed_noise**2 * problem.speed_period
    turning = problem.yaw_rate_noise**2 * problem.yaw_rate_period
    across = [side_sign(node.mount.side or "left") * 0.5 * node.forward.track_width for node in (one, other)]
    radii = one.forward.wheel_radius * other.forward.wheel_radius
    return (along + across[0] * across[1] * turning) / radii
