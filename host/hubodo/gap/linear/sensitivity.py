"""How the channels answer each effect: columns of the linearised model, by differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect, in_order
from hubodo.gap.linear.shared_speed import SharedSpeed
from hubodo.gap.state.state import State, stacked
from hubodo.model.inputs import SpeedCorrection

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


def columns(state: State, directions: Sequence[Direction]) -> dict[str, Array]:
    """For each node (P, 6, N) float32: change of its channels for a move by a scale along each direction."""
    nodes, given = state.problem.nodes, state.correction
    base = {name: stacked(reading) for name, reading in state.readings.items()}
    made = {node.name: np.zeros((len(directions), *node.y.shape), np.float32) for node in nodes}
    shared = SharedSpeed(state)
    for k, direction in enumerate(directions):
        there, own = direction.moved(_MOVE), [n.name for n in nodes if direction.node in ("", n.name)]
        moved = {name: _with(of, there) if name in own else of for name, of in state.effects.items()}
        # What changes the speed that the gyros of one node measured is felt by all the others.
        changed = shared.corrected(moved, own)
        more = None
        if given is not None and changed is not None:
            more = SpeedCorrection(given.t, (changed.speed - given.speed) / _MOVE)
        for node in nodes:
            follows = more is not None and shared.at_once(node)
            if node.name in own or (more is not None and not follows):
                correction = given if more is None or follows else changed
                reading = state.reading(node, moved[node.name].values(), correction)
                made[node.name][k] = (stacked(reading) - base[node.name]) / _MOVE
            if more is not None and follows:
                made[node.name][k] += shared.felt(node, more)
    return made


def _with(effects: Mapping[type[Effect], Effect], there: Effect) -> dict[type[Effect], Effect]:
    return {type(effect): effect for effect in in_order({**effects, type(there): there}.values())}
