"""Coupling of nodes by a speed that their gyros measured: an effect on one changes the readings of all."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.gap.linear.additive import AdditiveEffects, changes_only_geometry
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.state.measured_speed import average_speed_errors, build_measuring_chain
from hubodo.gap.state.state import Effects, State, stack_channels
from hubodo.model.inputs import ExtraSpeed, MotionCorrection, SpeedCorrection

# Steps of the finite differences, m/s and m/s².
_SPEED_STEP = 1e-5


class SpeedCoupling:
    """Change of the speed correction of a state by effects on the measuring nodes."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._added = {
            node.name: AdditiveEffects(
                build_measuring_chain(
                    node, state.effects[node.name], state.measured_offsets.get(node.name, 0.0)
                ),
                state.effects[node.name],
            )
            for node in state.problem.speed_source_nodes
        }

    def correction_slope(
        self, effects: Effects, effect: Effect, changed: Collection[str], step: float
    ) -> SpeedCorrection | None:
        """Return the change of the speed correction per `step` of an effect; None if it does not change.

        effects: effects of all nodes, including the changed one
        changed: names of the nodes with the changed effect
        """
        correction, sources = self._state.speed_correction, self._state.problem.speed_source_nodes
        changed_sources = [node for node in sources if node.name in changed]
        if correction is None or not changed_sources:
            return None
        if not any(self._moves_gyro(node, effects[node.name], effect) for node in changed_sources):
            return None
        if all(self._added[node.name].is_additive(type(effect)) for node in changed_sources):
            speed = average_speed_errors(
                sources,
                self._state.problem.speed_weights,
                {node.name: self._read(node, effect) for node in changed_sources},
                {node.name: self._state.speed_errors[node.name].true_times for node in changed_sources},
            )
            speed = self._state.problem.speed_filter.apply(speed)
        else:
            changed_correction = self._state.correct_speed(effects, changed)
            assert changed_correction is not None
            speed = changed_correction.speed - correction.speed
        return SpeedCorrection(correction.t, speed / step) if speed.any() else None

    def _moves_gyro(self, node: NodeData, effects: Mapping[type[Effect], Effect], effect: Effect) -> bool:
        """Return False if an effect only adds a lever arm, and forces do not affect the gyro."""
        if not changes_only_geometry(type(effect)) or self._added[node.name].gyro_depends_on_force:
            return True
        own = self._state.effects[node.name]
        before, after = (node.forward.geometry(some.values()) for some in (own, effects))
        return replace(after, lever_arm=before.lever_arm) != before

    def _read(self, node: NodeData, effect: Effect) -> Array:
        """Return the change of the error of the measured speed, (N,) m/s, by an additive effect."""
        rate = self._added[node.name].reading_change(effect)[2]
        return np.asarray(self._state.speed_errors[node.name].correction_per_rate * rate)


class SpeedSensitivity:
    """Sensitivity of a memoryless node to the speed that drives it."""

    def __init__(self, state: State, node: NodeData) -> None:
        self._t = state.predictions[node.name].body.t
        base, given = stack_channels(state.predictions[node.name]), state.speed_correction

        def slope(correction: MotionCorrection) -> Array:
            reading = state.predict(node, state.effects[node.name].values(), correction)
            return (stack_channels(reading) - base) / _SPEED_STEP

        # (6, N) each: change of the channels per m/s of speed, m/s² of acceleration and m of distance.
        columns = [
            slope(ExtraSpeed(speed=_SPEED_STEP, inner=given)),
            slope(ExtraSpeed(0.0, _SPEED_STEP, given)),
        ]
        if node.on_wheel:
            # The distance of a wheel is its angle times its radius.
            radius = node.forward.geometry(state.effects[node.name].values()).radius
            columns.append(state.phase_columns[node.name] / radius)
        self._answers, self._product = columns, np.empty_like(base)

    def add(self, slope: SpeedCorrection, columns: NDArray[np.float32]) -> None:
        """Add the node's change for a slope of the speed correction to `columns`, (6, N)."""
        total = np.zeros_like(self._answers[0])
        for column, value in zip(self._answers, slope.at(self._t), strict=False):
            total += np.multiply(column, value, out=self._product)
        columns += total
