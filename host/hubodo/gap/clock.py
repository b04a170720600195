"""How late the stamps of each node are beside those of the inputs, where their clocks are known to differ."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.noise import ChannelNoise, sensor_noise
from hubodo.gap.problem import Problem
from hubodo.gap.state import State, predict
from hubodo.gap.wander import Weights, walked_late


def follow_clocks(problem: Problem, state: State, walks: dict[str, float]) -> dict[str, Array]:
    """(N,) s for each node: how late its stamps are, as everything that was declared makes most likely.

    walks: rad²/s, of the wheels.
    """
    noise = {}
    for node in problem.nodes:
        found = np.broadcast_to(sensor_noise(problem), node.y.shape)
        noise[node.name] = ChannelNoise(found, np.ones(len(node.t), bool))
    beside = walked_late(problem, state, predict(problem, state), Weights(noise, walks))
    return {name: state.late.get(name, 0.0) + more for name, more in beside.items()}
