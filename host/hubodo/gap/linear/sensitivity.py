"""How the channels answer each effect: columns of the linearised model, by differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect, in_order
from hubodo.gap.linear.added import Added
from hubodo.gap.linear.shared_speed import SharedSpeed
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.state.state import State, stacked
from hubodo.model.inputs import MotionCorrection, SpeedCorrection

# Of a scale: at the end of a long log even a small step of a radius turns the wheel far.
_MOVE = 1e-6


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


def columns(state: State, directions: Sequence[Direction]) -> Iterator[tuple[NodeData, list[int], Array]]:
    """For each node the directions that it feels, and (p, 6, N) float32: change of its channels for a scale.

    One node after the other, as they take much memory; where gyros measured the speed, all nodes feel all.
    """
    nodes, shared = state.problem.nodes, SharedSpeed(state)
    if state.problem.sources:
        yield from _together(state, directions, list(range(len(directions))), nodes, shared)
        return
    for node in nodes:
        felt = [k for k, direction in enumerate(directions) if direction.node in ("", node.name)]
        yield from _together(state, directions, felt, (node,), shared)


def _together(
    state: State,
    directions: Sequence[Direction],
    felt: list[int],
    nodes: Sequence[NodeData],
    shared: SharedSpeed,
) -> Iterator[tuple[NodeData, list[int], Array]]:
    """The columns of some nodes that feel the same directions."""
    made = {node.name: np.zeros((len(felt), *node.y.shape), np.float32) for node in nodes}
    moves = {node.name: _Moves(state, node) for node in nodes}
    for row, direction in enumerate(directions[k] for k in felt):
        there = direction.moved(_MOVE)
        own = [node.name for node in state.problem.nodes if direction.node in ("", node.name)]
        effects = {name: _with(of, there) if name in own else of for name, of in state.effects.items()}
        # What changes the speed that the gyros of one node measured is felt by all the others.
        more = shared.more(effects, there, own, _MOVE)
        for node in nodes:
            mine, into = node.name in own, made[node.name][row]
            if more is not None and not shared.at_once(node):
                into[:] = moves[node.name].anew(effects[node.name], more)
            elif more is not None:
                into[:] = shared.felt(node, more)
                into += moves[node.name].change(effects[node.name], there) if mine else 0.0
            elif mine:
                into[:] = moves[node.name].change(effects[node.name], there)
    for node in nodes:
        yield node, felt, made.pop(node.name)


class _Moves:
    """How one node answers another effect, from where a state stands, per scale."""

    def __init__(self, state: State, node: NodeData) -> None:
        self._state, self._node = state, node
        self._base = stacked(state.readings[node.name])
        self._added = Added(state.reached(node), state.effects[node.name])

    def change(self, effects: Mapping[type[Effect], Effect], there: Effect) -> Array:
        """(6, N), the motion as it is. effects: of the node, with that other one, `there`."""
        if self._added.does(type(there)):
            return self._added.change(there) / _MOVE
        return self._against(effects, self._state.correction)

    def anew(self, effects: Mapping[type[Effect], Effect], more: SpeedCorrection) -> Array:
        """(6, N), the speed corrected by so much more per scale."""
        given = self._state.correction
        assert given is not None
        return self._against(effects, SpeedCorrection(given.t, given.speed + _MOVE * more.speed))

    def _against(self, effects: Mapping[type[Effect], Effect], correction: MotionCorrection | None) -> Array:
        reading = self._state.reading(self._node, effects.values(), correction)
        return (stacked(reading) - self._base) / _MOVE


def _with(effects: Mapping[type[Effect], Effect], there: Effect) -> dict[type[Effect], Effect]:
    return {type(effect): effect for effect in in_order({**effects, type(there): there}.values())}
