"""Weights of residuals: noise of each channel and random walk of each wheel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.state.noise import ChannelNoise, declared_sensor_sigma, estimate_channel_noise
from hubodo.gap.state.state import State
from hubodo.vehicle import side_sign

# rad²/s; lower bound of a wheel's walk, whatever noise is declared for the inputs.
_MIN_WHEEL_WALK = 1e-10


@dataclass(frozen=True)
class Weights:
    """Weights of residuals.

    noise: noise of the channels of each node
    wheel_walks: rad²/s, intensity of the random walk of each wheel's angle
    """

    noise: Mapping[str, ChannelNoise]
    wheel_walks: Mapping[str, float]


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
