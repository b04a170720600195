"""Tracking of wheel angles and stamp delays for a given state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.weights import (
    Weights,
    declared_weights,
    declared_wheel_walk,
    weights_from_residuals,
)
from hubodo.gap.process_noise.wheel_phase import estimate_phases, interpolate_phases, smooth_phases
from hubodo.gap.state.state import State

# A second pass about the first estimate is more accurate; a third would change nothing.
_TRACKING_PASSES = 2


def track_wheel_phase(state: State) -> tuple[State, dict[str, float]]:
    """Track the phase offset of each wheel, and the stamp delays if clocks are declared to differ.

    Returns the new state and the intensity of each wheel's walk, rad²/s.
    """
    problem = state.problem
    walks = {node.name: declared_wheel_walk(problem, node) for node in problem.nodes if node.on_wheel}
    for _ in range(_TRACKING_PASSES):
        if problem.model.inputs.clock_sigma > 0.0 and (state.phase_offsets or not walks):
            state = replace(state, stamp_delays=_track_stamp_delays(state, walks))
        offsets = dict(state.phase_offsets)
        for node in problem.nodes:
            if node.on_wheel:
                sigma = _accel_noise(problem, node)
                phases = estimate_phases(node, state.predictions[node.name], offsets.get(node.name), sigma)
                offset, walks[node.name] = smooth_phases(
                    phases, declared_wheel_walk(problem, node), state.has_steady_wheels
                )
                offsets[node.name] = interpolate_phases(node, phases, offset)
        measured_offsets = _track_measured_offsets(state, offsets)
        state = replace(state, phase_offsets=offsets, measured_offsets=measured_offsets)
    return state, walks


def _track_measured_offsets(state: State, offsets: Mapping[str, Array]) -> dict[str, Array]:
    """Return `State.measured_offsets`.

    state: about which the wheels were tracked; offsets: (N,) rad, tracked
    """
    measured_offsets = {}
    for name, error in state.speed_errors.items():
        rolling = state.predictions[name].rolling
        assert rolling is not None
        angle = rolling.angle - state.phase_offsets.get(name, 0.0) + offsets[name]
        measured_offsets[name] = angle - (error.angle - state.measured_offsets.get(name, 0.0))
    return measured_offsets


def estimate_weights(state: State) -> Weights:
    """Estimate weights from the state's own residual and the walks of its wheels."""
    return weights_from_residuals(*track_wheel_phase(state))


def _accel_noise(problem: Problem, node: NodeData) -> float:
    """Return 1 sigma of the accelerometer, m/s²: declared, or estimated if that is larger."""
    return max(problem.model.noise.accel, node.accel_scatter)


def _track_stamp_delays(state: State, walks: Mapping[str, float]) -> dict[str, Array]:
    """Return the most likely stamp delay for each node, (N,) s; `walks`: rad²/s, of the wheels."""
    delays = {
        node.name: np.zeros(len(node.t)) + state.stamp_delays.get(node.name, 0.0)
        for node in state.problem.nodes
    }
    for estimate in Evaluation(state, declared_weights(state.problem, walks)).estimate_process_noise():
        for component, _, mean in estimate.components:
            if component.source == "clock":
                delays[estimate.node.name][estimate.samples] += mean
    return delays
