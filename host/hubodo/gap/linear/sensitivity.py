"""How the channels answer each effect: columns of the linearised model, by differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect, in_order
from hubodo.gap.state.state import State, speed_correction, stacked

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
    problem, given = state.problem, state.correction
    base = {name: stacked(reading) for name, reading in state.readings.items()}
    made = {node.name: np.zeros((len(directions), *node.y.shape), np.float32) for node in problem.nodes}
    for k, direction in enumerate(directions):
        there = direction.moved(_MOVE)
        moved: dict[str, Mapping[type[Effect], Effect]] = {
            name: _with(of, there) if direction.node in ("", name) else of
            for name, of in state.effects.items()
        }
        correction = given
        if given is not None and direction.node in ("", *problem.measured_by):
            correction = speed_correction(problem, moved)
        # What changes the speed that the gyros of one node measured is felt by all the others.
        shared = given is not None and correction is not None and (correction.speed != given.speed).any()
        for node in problem.nodes:
            if shared or direction.node in ("", node.name):
                change = stacked(state.reading(node, moved[node.name].values(), correction))
                change -= base[node.name]
                made[node.name][k] = change / _MOVE
    return made


def _with(effects: Mapping[type[Effect], Effect], there: Effect) -> dict[type[Effect], Effect]:
    return {type(effect): effect for effect in in_order({**effects, type(there): there}.values())}
