"""How the channels answer each effect: columns of the linearised model, by differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import Effect, in_order
from hubodo.effects.base import SensorChain
from hubodo.gap.linear.added import Added
from hubodo.gap.linear.shared_speed import SharedSpeed, SpeedAnswers
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

    def felt_by(self, node: NodeData) -> bool:
        """Whether it is on that node, or on the vehicle."""
        return self.node in ("", node.name)

    def moved(self, by: float) -> Effect:
        """The effect, `by` scales further."""
        coordinates = self.effect.coordinates().copy()
        coordinates[self.coordinate] += by * self.scale
        return self.effect.with_coordinates(coordinates)


class Directions:
    """How the channels of each node answer directions, at a state: a stretch of time after the other.

    at: for each node the directions that it feels, by their places; where gyros measured the speed, all.
    What hangs on what was before is worked out with all that was, and kept.
    """

    def __init__(self, state: State, directions: Sequence[Direction]) -> None:
        self._state, self._directions = state, directions
        self._shared = SharedSpeed(state) if state.problem.sources else None
        nodes = state.problem.nodes
        self.at = {
            node.name: [k for k, it in enumerate(directions) if self._shared or it.felt_by(node)]
            for node in nodes
        }
        # What a node keeps of an evaluation goes with the copy.
        whole = state.part({node.name: slice(0, len(node.t)) for node in nodes})
        nodes = whole.problem.nodes
        self._chains = {node.name: whole.reached(node) for node in nodes if not state.at_once(node.name)}
        self._moved = [direction.moved(_MOVE) for direction in directions]
        self._more: dict[int, SpeedCorrection] = {}
        self._kept = {node.name: dict[int, NDArray[np.float32]]() for node in nodes}
        moves = {node.name: _Moves(whole, node, self._chains.get(node.name)) for node in nodes}
        for k, direction in enumerate(directions):
            there = self._moved[k]
            own = [node.name for node in nodes if direction.felt_by(node)]
            effects = {name: _with(of, there) if name in own else of for name, of in state.effects.items()}
            # What changes the speed that the gyros of one node measured is felt by all the others.
            more = self._shared and self._shared.more(effects, there, own, _MOVE)
            if more:
                self._more[k] = more
            for node in nodes:
                move, at_once = moves[node.name], state.at_once(node.name)
                if more and not at_once:
                    made = move.anew(effects[node.name], more)
                elif node.name in own and (there.has_memory or not (at_once or move.adds(there))):
                    made = move.change(effects[node.name], there)
                else:
                    continue
                self._kept[node.name][k] = made.astype(np.float32)

    def of(self, node: NodeData, state: State, samples: Mapping[str, slice]) -> NDArray[np.float32]:
        """(P, 6, N): change of the channels for a scale. node, state: of these samples alone."""
        felt, kept, inside = self.at[node.name], self._kept[node.name], samples[node.name]
        made = np.zeros((len(felt), *node.y.shape), np.float32)
        chain = self._chains.get(node.name)
        moves = _Moves(state, node, chain and chain.select(inside))
        answers = SpeedAnswers(state, node) if self._more and state.at_once(node.name) else None
        for into, k in zip(made, felt, strict=True):
            direction, more = self._directions[k], self._more.get(k)
            if k in kept:
                into[:] = kept[k][:, inside]
            elif direction.felt_by(node):
                there = self._moved[k]
                into[:] = moves.change(_with(state.effects[node.name], there), there)
            if answers and more:
                answers.add(more, into)
        return made


class _Moves:
    """How one node answers another effect, from where a state stands, per scale."""

    def __init__(self, state: State, node: NodeData, chain: SensorChain | None = None) -> None:
        """chain: what reaches the sensor, where that hangs on what was before."""
        self._state, self._node, self._chain = state, node, chain

    @cached_property
    def _base(self) -> Array:
        return stacked(self._state.readings[self._node.name])

    @cached_property
    def _added(self) -> Added:
        chain = self._chain or self._state.reached(self._node)
        return Added(chain, self._state.effects[self._node.name])

    def adds(self, there: Effect) -> bool:
        """Whether an effect does nothing but add to what is read."""
        return self._added.does(type(there))

    def change(self, effects: Mapping[type[Effect], Effect], there: Effect) -> Array:
        """(6, N), the motion as it is. effects: of the node, with that other one, `there`."""
        if self.adds(there):
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
