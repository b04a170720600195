"""The speed that gyros of some nodes measured, and how all nodes answer where it was measured otherwise."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.gap.linear.added import Added
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.state.measured_speed import joined, measuring_chain
from hubodo.gap.state.state import Effects, State, stacked
from hubodo.model.inputs import ExtraSpeed, MotionCorrection, SpeedCorrection

# m/s and m/s²: what is differentiated is as smooth as the motion, and nothing large is in it.
_DRIVEN = 1e-5


class SharedSpeed:
    """How the nodes answer, at a state, a speed that was measured otherwise."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._added = {
            node.name: Added(measuring_chain(node, state.effects[node.name]), state.effects[node.name])
            for node in state.problem.sources
        }

    def more(
        self, effects: Effects, there: Effect, changed: Collection[str], by: float
    ) -> SpeedCorrection | None:
        """How the correction changes, per `by`, where nodes `changed` have an effect in place of their own.

        effects: all of all nodes, with it. None where it stays what it is.
        """
        given, sources = self._state.correction, self._state.problem.sources
        moved = [node for node in sources if node.name in changed]
        if given is None or not moved:
            return None
        if all(self._added[node.name].does(type(there)) for node in moved):
            speed = joined(sources, {node.name: self._read(node, there) for node in moved})
        else:
            made = self._state.corrected(effects, changed)
            assert made is not None
            speed = made.speed - given.speed
        return SpeedCorrection(given.t, speed / by) if speed.any() else None

    def _read(self, node: NodeData, there: Effect) -> Array:
        """(N,) m/s: change of a gyro's error by what an effect adds to its reading."""
        rate = self._added[node.name].change(there)[2]
        return np.asarray(self._state.speed_errors[node.name].per_rate * rate)


class SpeedAnswers:
    """How one node that answers at once answers a little more of the speed that drives it."""

    def __init__(self, state: State, node: NodeData) -> None:
        self._t = state.readings[node.name].body.t
        base, given = stacked(state.readings[node.name]), state.correction

        def slope(by: MotionCorrection) -> Array:
            reading = state.reading(node, state.effects[node.name].values(), by)
            return (stacked(reading) - base) / _DRIVEN

        # (6, N) each: change of the channels per m/s of speed, m/s² of acceleration, m of distance.
        answers = [slope(ExtraSpeed(speed=_DRIVEN, inner=given)), slope(ExtraSpeed(0.0, _DRIVEN, given))]
        if node.on_wheel:
            # The way that a wheel has gone is how far it is round.
            radius = node.forward.geometry(state.effects[node.name].values()).radius
            answers.append(state.phase_columns[node.name] / radius)
        self._answers = answers

    def add(self, more: SpeedCorrection, into: NDArray[np.float32]) -> None:
        """The change of the node's channels for a little more correction, to (6, N)."""
        into += sum(answer * by for answer, by in zip(self._answers, more.at(self._t), strict=False))
