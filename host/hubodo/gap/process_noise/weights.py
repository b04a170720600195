"""What residuals are weighed with: the noise of each channel, and how much each wheel wanders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.state.noise import ChannelNoise, channel_noise, sensor_noise
from hubodo.gap.state.state import State
from hubodo.vehicle import side_sign

# rad²/s: no wheel is known better than this, whatever is declared of the inputs.
_LEAST_WALK = 1e-10


@dataclass(frozen=True)
class Weights:
    """noise: 1 sigma of the channels, by node. walks: rad²/s, intensity of the walk of each wheel."""

    noise: Mapping[str, ChannelNoise]
    walks: Mapping[str, float]


def declared_weights(problem: Problem, walks: Mapping[str, float]) -> Weights:
    """With the noise that the model file declares."""
    noise = {}
    for node in problem.nodes:
        alike, fresh = np.zeros(len(node.t), np.uint8), np.ones(len(node.t), bool)
        noise[node.name] = ChannelNoise(sensor_noise(problem), alike, fresh)
    return Weights(noise, walks)


def weights_of(state: State, walks: Mapping[str, float]) -> Weights:
    """With the noise that the residuals of a state show."""
    noise = {
        node.name: channel_noise(state.problem, node, state.readings[node.name], state.residual(node))
        for node in state.problem.nodes
    }
    return Weights(noise, walks)


def declared_walk(problem: Problem, node: NodeData) -> float:
    """rad²/s: how much a wheel's angle wanders when the noise of the inputs is integrated."""
    return max(shared_walk(problem, node, node), _LEAST_WALK)


def shared_walk(problem: Problem, one: NodeData, other: NodeData) -> float:
    """rad²/s: covariance of the steps of two wheels' angles, as both integrate the noise of the same inputs.

    A wheel on the side y turns by the integral of (speed - y yaw rate) / radius.
    """
    along = problem.speed_noise**2 * problem.speed_period
    turning = problem.yaw_rate_noise**2 * problem.yaw_rate_period
    across = [side_sign(node.mount.side or "left") * 0.5 * node.forward.track_width for node in (one, other)]
    radii = one.forward.wheel_radius * other.forward.wheel_radius
    return (along + across[0] * across[1] * turning) / radii
