"""Sensitivity of the channels to each effect, by finite differences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import Effect, sort_effects
from hubodo.effects.sensor_chain import SensorChain
from hubodo.gap.linear.additive import AdditiveEffects
from hubodo.gap.linear.shared_speed import SpeedCoupling, SpeedSensitivity
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.state.state import State, stack_channels
from hubodo.model.inputs import MotionCorrection, SpeedCorrection

# Step in scales of a coordinate; over a long log even a small change of radius accumulates to many turns.
_STEP_SCALES = 1e-6


@dataclass(frozen=True)
class Direction:
    """One coordinate of an effect on one node, about its current value.

    node: name; "" for the vehicle, which acts on every node
    """

    effect: Effect
    node: str
    coordinate: int

    @property
    def scale(self) -> float:
        return float(self.effect.coordinate_scales()[self.coordinate])

    def affects(self, node: NodeData) -> bool:
        """Return True if it acts on that node or on the vehicle."""
        return self.node in ("", node.name)

    def shifted_effect(self, scales: float) -> Effect:
        """Return the effect moved by some scales."""
        coordinates = self.effect.coordinates().copy()
        coordinates[self.coordinate] += scales * self.scale
        return self.effect.with_coordinates(coordinates)


class DirectionSensitivities:
    """Sensitivity of each node's channels to directions, segment by segment.

    indices: for each node the directions that act on it; all of them if gyros measured the speed. Columns of
        effects with memory are computed for the whole log at once and stored.
    """

    def __init__(self, state: State, directions: Sequence[Direction]) -> None:
        self._state, self._directions = state, directions
        self._shared = SpeedCoupling(state) if state.problem.speed_source_nodes else None
        nodes = state.problem.nodes
        self.indices = {
            node.name: [
                k for k, direction in enumerate(directions) if self._shared or direction.affects(node)
            ]
            for node in nodes
        }
        # Cached intermediate results are released together with this copy.
        full = state.select({node.name: slice(0, len(node.t)) for node in nodes})
        nodes = full.problem.nodes
        self._chains = {
            node.name: full.sensor_chain(node) for node in nodes if not state.is_memoryless(node.name)
        }
        self._shifted = [direction.shifted_effect(_STEP_SCALES) for direction in directions]
        self._more: dict[int, SpeedCorrection] = {}
        self._stored = {node.name: dict[int, NDArray[np.float32]]() for node in nodes}
        moves = {node.name: _NodeResponse(full, node, self._chains.get(node.name)) for node in nodes}
        for k, direction in enumerate(directions):
            shifted = self._shifted[k]
            affected = [node.name for node in nodes if direction.affects(node)]
            effects = {
                name: _replace_effect(node_effects, shifted) if name in affected else node_effects
                for name, node_effects in state.effects.items()
            }
            # If one node's gyro measures the speed, a change of its reading affects all other nodes.
            slope = self._shared and self._shared.correction_slope(effects, shifted, affected, _STEP_SCALES)
            if slope:
                self._more[k] = slope
            for node in nodes:
                move, at_once = moves[node.name], state.is_memoryless(node.name)
                if slope and not at_once:
                    column = move.speed_change(effects[node.name], slope)
                elif node.name in affected and (
                    shifted.has_memory or not (at_once or move.is_additive(shifted))
                ):
                    column = move.effect_change(effects[node.name], shifted)
                else:
                    continue
                self._stored[node.name][k] = column.astype(np.float32)

    def columns(self, node: NodeData, state: State, samples: Mapping[str, slice]) -> NDArray[np.float32]:
        """Return the change of the channels per scale, (P, 6, N).

        node, state: restricted to the given samples
        """
        indices, stored, inside = self.indices[node.name], self._stored[node.name], samples[node.name]
        columns = np.zeros((len(indices), *node.y.shape), np.float32)
        chain = self._chains.get(node.name)
        response = _NodeResponse(state, node, chain and chain.select(inside))
        speed_sensitivity = (
            SpeedSensitivity(state, node) if self._more and state.is_memoryless(node.name) else None
        )
        for column, k in zip(columns, indices, strict=True):
            direction, slope = self._directions[k], self._more.get(k)
            if k in stored:
                column[:] = stored[k][:, inside]
            elif direction.affects(node):
                shifted = self._shifted[k]
                column[:] = response.effect_change(
                    _replace_effect(state.effects[node.name], shifted), shifted
                )
            if speed_sensitivity and slope:
                speed_sensitivity.add(slope, column)
        return columns


class _NodeResponse:
    """Response of one node to a changed effect, per scale."""

    def __init__(self, state: State, node: NodeData, chain: SensorChain | None = None) -> None:
        """Prepare for one node; chain: physical input of its sensor, if it depends on earlier samples."""
        self._state, self._node, self._chain = state, node, chain

    @cached_property
    def _base(self) -> Array:
        return stack_channels(self._state.predictions[self._node.name])

    @cached_property
    def _added(self) -> AdditiveEffects:
        chain = self._chain or self._state.sensor_chain(self._node)
        return AdditiveEffects(chain, self._state.effects[self._node.name])

    def is_additive(self, effect: Effect) -> bool:
        """Return True if an effect only adds to the readings."""
        return self._added.is_additive(type(effect))

    def effect_change(self, effects: Mapping[type[Effect], Effect], effect: Effect) -> Array:
        """Return the change of the channels, (6, N), for unchanged motion.

        effects: effects of the node, including the changed one
        """
        if self.is_additive(effect):
            return self._added.reading_change(effect) / _STEP_SCALES
        return self._difference(effects, self._state.speed_correction)

    def speed_change(self, effects: Mapping[type[Effect], Effect], slope: SpeedCorrection) -> Array:
        """Return the change of the channels, (6, N), with the speed corrected by `slope` per scale."""
        given = self._state.speed_correction
        assert given is not None
        return self._difference(effects, SpeedCorrection(given.t, given.speed + _STEP_SCALES * slope.speed))

    def _difference(
        self, effects: Mapping[type[Effect], Effect], correction: MotionCorrection | None
    ) -> Array:
        reading = self._state.predict(self._node, effects.values(), correction)
        return (stack_channels(reading) - self._base) / _STEP_SCALES


def _replace_effect(effects: Mapping[type[Effect], Effect], effect: Effect) -> dict[type[Effect], Effect]:
    return {type(effect): effect for effect in sort_effects({**effects, type(effect): effect}.values())}
