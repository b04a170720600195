"""Wheels and clocks followed at a state: how far round each wheel is, how late the stamps of each node."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.point import Point
from hubodo.gap.process_noise.weights import Weights, declared_walk, declared_weights, weights_of
from hubodo.gap.process_noise.wheel_phase import follow, on_samples, smoothed
from hubodo.gap.state.state import State

# A wheel followed about its own path is followed better; a third time changes nothing.
_FOLLOWED = 2


def track_wheel_phase(state: State) -> tuple[State, dict[str, float]]:
    """The state with the path of each wheel followed anew, and how much each path wanders, rad²/s.

    Clocks that are declared to differ are followed with them.
    """
    problem = state.problem
    walks = {node.name: declared_walk(problem, node) for node in problem.nodes if node.on_wheel}
    for _ in range(_FOLLOWED):
        if problem.model.inputs.clock_sigma > 0.0 and (state.paths or not walks):
            state = replace(state, late=_follow_clocks(state, walks))
        paths = dict(state.paths)
        for node in problem.nodes:
            if node.on_wheel:
                sigma = _accel_noise(problem, node)
                phases = follow(node, state.readings[node.name], paths.get(node.name), sigma)
                path, walks[node.name] = smoothed(phases, declared_walk(problem, node))
                paths[node.name] = on_samples(node, phases, path)
        state = replace(state, paths=paths)
    return state, walks


def own_weights(state: State) -> Weights:
    """Weights from the state's own residual and its wheels' own walks."""
    return weights_of(*track_wheel_phase(state))


def _accel_noise(problem: Problem, node: NodeData) -> float:
    """m/s²: as declared, or as the samples scatter where that is more."""
    return max(problem.model.noise.accel, node.accel_scatter)


def _follow_clocks(state: State, walks: Mapping[str, float]) -> dict[str, Array]:
    """(N,) s for each node: how late its stamps are, as everything that was declared makes most likely.

    walks: rad²/s, of the wheels.
    """
    late = {node.name: np.zeros(len(node.t)) + state.late.get(node.name, 0.0) for node in state.problem.nodes}
    for it in Point(state, declared_weights(state.problem, walks)).wandered():
        for wandering, _, mean in it.made:
            if wandering.what == "clock":
                late[it.node.name][it.samples] += mean
    return late
