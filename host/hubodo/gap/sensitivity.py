"""How the channels answer each effect: columns of the linearised model, by differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect, in_order
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.state import State, effects_of, predict_node, speed_correction, stacked
from hubodo.model.forward import Start
from hubodo.model.inputs import Later

# Of a scale: at the end of a long log even a small step of a radius turns the wheel far.
_MOVE = 1e-6
_STEP = 1e-3
_LATE_STEP = 1e-4
ATTITUDE_SCALE = 0.05


@dataclass(frozen=True)
class Direction:
    """One way to move the model: one coordinate of an effect on one node, from where it stands there.

    node "": the vehicle, felt by every node. scale: length of the move that counts as one.
    """

    effect: Effect
    node: str
    coordinate: int

    @property
    def scale(self) -> float:
        return float(self.effect.coordinate_scales()[self.coordinate])

    def moved(self, by: float) -> Effect:
        """The effect, `by` scales further."""
        coordinates = self.effect.coordinates().copy()
        coordinates[self.coordinate] += by * self.scale
        return self.effect.at(coordinates)


def columns(problem: Problem, state: State, directions: Sequence[Direction]) -> dict[str, Array]:
    """For each node (P, 6, N) float32: change of its channels for a move by a scale along each direction."""
    effects = effects_of(problem, state.terms)
    given = speed_correction(problem, effects)
    base = {
        node.name: stacked(predict_node(node, effects[node.name].values(), state, given))
        for node in problem.nodes
    }
    made = {node.name: np.zeros((len(directions), *node.y.shape), np.float32) for node in problem.nodes}
    for k, direction in enumerate(directions):
        there = direction.moved(_MOVE)
        moved: dict[str, Mapping[type[Effect], Effect]] = {
            name: _with(of, there) if direction.node in ("", name) else of for name, of in effects.items()
        }
        correction = given
        if given is not None and direction.node in ("", *problem.measured_by):
            correction = speed_correction(problem, moved)
        # What changes the speed that the gyros of one node measured is felt by all the others.
        shared = given is not None and correction is not None and (correction.speed != given.speed).any()
        for node in problem.nodes:
            if shared or direction.node in ("", node.name):
                change = stacked(predict_node(node, moved[node.name].values(), state, correction))
                change -= base[node.name]
                made[node.name][k] = change / _MOVE
    return made


def _with(effects: Mapping[type[Effect], Effect], there: Effect) -> dict[type[Effect], Effect]:
    return {type(effect): effect for effect in in_order({**effects, type(there): there}.values())}


def phase_column(problem: Problem, node: NodeData, state: State) -> Array:
    """(6, N) per rad: change of the channels when the wheel is further round than it is thought to be."""
    path = state.paths.get(node.name, np.zeros(1))
    return _slope(problem, node, lambda by: replace(state, paths={**state.paths, node.name: path + by}))


def late_column(problem: Problem, node: NodeData, state: State) -> Array:
    """(6, N) per s: change of the channels when the stamps are later than they are thought to be."""
    effects = effects_of(problem, state.terms)
    own, before = effects[node.name].values(), speed_correction(problem, effects)
    late, early = (
        stacked(predict_node(node, own, state, Later(by, before))) for by in (_LATE_STEP, -_LATE_STEP)
    )
    return (late - early) / (2.0 * _LATE_STEP)


def attitude_columns(problem: Problem, node: NodeData, state: State) -> Array:
    """(3, 6, N): change of the channels for turns of a node on the body by ATTITUDE_SCALE about each axis."""
    attitude = np.array(state.starts.get(node.name, Start()).attitude)

    def turned(axis: Array, by: float) -> State:
        x, y, z = (attitude + by * axis).tolist()
        return replace(state, starts={**state.starts, node.name: Start(attitude=(x, y, z))})

    return np.stack([_slope(problem, node, partial(turned, axis)) for axis in np.eye(3) * ATTITUDE_SCALE])


def _slope(problem: Problem, node: NodeData, at: Callable[[float], State]) -> Array:
    """(6, N): change of the channels along `at`, per unit."""
    state = at(0.0)
    effects = effects_of(problem, state.terms)
    correction = speed_correction(problem, effects)
    own = effects[node.name].values()
    ahead, behind = (stacked(predict_node(node, own, at(by), correction)) for by in (_STEP, -_STEP))
    return (ahead - behind) / (2.0 * _STEP)
