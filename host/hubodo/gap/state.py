"""The model at one point: its terms, the start of each node, the path of each wheel; and what it predicts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.terms import Term, effects_on
from hubodo.model.forward import Reading, Start
from hubodo.model.inputs import MotionCorrection, SpeedCorrection
from hubodo.vehicle import facing_sign


@dataclass(frozen=True)
class State:
    """terms: the effects. starts: wheel angle or attitude of each node. paths: for each wheel node (N,) rad,
    the angle that the wheel turned and the model with its inputs does not know. late: for each node (N,) s,
    by how much its stamps are late, where clocks are declared to differ."""

    terms: tuple[Term, ...] = ()
    starts: Mapping[str, Start] = field(default_factory=dict)
    paths: Mapping[str, Array] = field(default_factory=dict)
    late: Mapping[str, Array] = field(default_factory=dict)

    def with_terms(self, terms: Sequence[Term]) -> State:
        return replace(self, terms=tuple(terms))

    def afresh(self, terms: Sequence[Term]) -> State:
        """With other terms, wheels and clocks not yet followed: where they went under these may mislead."""
        return replace(self, terms=tuple(terms), paths={}, late={})


Effects = Mapping[str, Mapping[type[Effect], Effect]]
"""What each node has, by its name and then by the kind of effect."""


def effects_of(problem: Problem, terms: Iterable[Term]) -> Effects:
    """What each node of the problem has of the terms."""
    terms = list(terms)
    return {node.name: effects_on(node, terms) for node in problem.nodes}


def predict(problem: Problem, state: State) -> dict[str, Reading]:
    """What each node should have read."""
    effects = effects_of(problem, state.terms)
    correction = speed_correction(problem, effects)
    return {
        node.name: predict_node(node, effects[node.name].values(), state, correction)
        for node in problem.nodes
    }


def predict_node(
    node: NodeData, effects: Iterable[Effect], state: State, correction: MotionCorrection | None = None
) -> Reading:
    """What one node should have read, (3, N) each."""
    start, path = state.starts.get(node.name, Start()), state.paths.get(node.name, 0.0)
    return node.forward.mean(effects, start, path, correction, state.late.get(node.name, 0.0))


def stacked(reading: Reading) -> Array:
    """(6, N): gyro over accel."""
    return np.concatenate([reading.gyro, reading.accel])


def speed_correction(problem: Problem, effects: Effects) -> SpeedCorrection | None:
    """Where gyros measured the speed: what the errors that the model gives them did to it.

    The input took nominal radius times what the z gyros read for the speed.
    """
    if not problem.measured_by:
        return None
    sources = [node for node in problem.nodes if node.name in problem.measured_by]
    parts = []
    for node in sources:
        reading = node.forward.mean([e for e in effects[node.name].values() if e.shows == "mean"], Start())
        rolling, body = reading.rolling, reading.body
        if rolling is None:
            continue
        nominal, side = node.forward.wheel_radius, 1.0 if node.mount.side == "left" else -1.0
        y = 0.5 * side * node.forward.track_width
        beside = facing_sign(node.mount.facing or "left") * reading.gyro[2] - rolling.spin
        contact = body.speed - body.yaw_rate * y
        turning = np.abs(rolling.spin) > 1e-2
        radius = np.where(turning, contact / np.where(turning, rolling.spin, 1.0), nominal)
        wrong = (radius / nominal - 1.0) * contact - radius * beside
        parts.append((node.t, wrong if len(sources) > 1 else wrong + body.yaw_rate * y))
    t = parts[0][0]
    return SpeedCorrection(t, np.mean([np.interp(t, *part) for part in parts], axis=0))
