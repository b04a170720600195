"""The speed that gyros of some nodes measured, and how all nodes answer where it was measured otherwise."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.gap.linear.added import Added
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.state.measured_speed import joined, measuring_chain
from hubodo.gap.state.state import Effects, State, stacked
from hubodo.model.inputs import Driven, MotionCorrection, SpeedCorrection

# m/s and m/s²: what is differentiated is as smooth as the motion, and nothing large is in it.
_DRIVEN = 1e-5


@dataclass(frozen=True)
class _Answers:
    """Change of the channels of a node, (6, N), per m/s of speed, m/s² of acceleration and m of distance."""

    speed: Array
    acceleration: Array
    distance: Array


class SharedSpeed:
    """How the nodes answer, at a state, a speed that was measured otherwise."""

    def __init__(self, state: State) -> None:
        self._state = state
        self._answers: dict[str, _Answers] = {}
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

    def at_once(self, node: NodeData) -> bool:
        """Whether a node answers at any time only what is true at that time."""
        return not any(kind.remembers for kind in self._state.effects[node.name])

    def felt(self, node: NodeData, more: SpeedCorrection) -> Array:
        """(6, N): change of a node's channels for a little more correction; for those that answer at once."""
        answers = self._answers.get(node.name) or self._answered(node)
        speed, acceleration, distance = more.at(self._state.readings[node.name].body.t)
        made = answers.speed * speed + answers.acceleration * acceleration
        if node.on_wheel:
            made += answers.distance * distance
        return made

    def _answered(self, node: NodeData) -> _Answers:
        state, given = self._state, self._state.correction
        base = stacked(state.readings[node.name])

        def slope(by: MotionCorrection) -> Array:
            reading = state.reading(node, state.effects[node.name].values(), by)
            return (stacked(reading) - base) / _DRIVEN

        speed, acceleration = slope(Driven(speed=_DRIVEN, before=given)), slope(Driven(0.0, _DRIVEN, given))
        distance: Array = np.zeros(1)
        if node.on_wheel:
            # The way that a wheel has gone is how far it is round.
            radius = node.forward.geometry(state.effects[node.name].values()).radius
            distance = state.phase_columns[node.name] / radius
        made = self._answers[node.name] = _Answers(speed, acceleration, distance)
        return made
