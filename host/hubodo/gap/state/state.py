"""The model as it stands: its terms, the start of each node, the path of each wheel; and what it predicts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.effects.base import SensorChain
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.state.measured_speed import SpeedError, joined, speed_error
from hubodo.gap.state.noise import InputAnswers, input_answers
from hubodo.gap.state.terms import ModelTerm, effects_on
from hubodo.model.forward import NodeInitialState, NodeReading
from hubodo.model.inputs import DelayedMotion, MotionCorrection, SpeedCorrection

# rad, or of ATTITUDE_SCALE: half of a central difference; its cube is below the rounding of a log.
_STEP = 1e-3
# s: the same for the stamps.
_LATE_STEP = 1e-4
# rad: a turn of a node on the body that would not surprise anybody.
ATTITUDE_SCALE = 0.05

Effects = Mapping[str, Mapping[type[Effect], Effect]]
"""What each node has, by its name and then by the kind of effect."""


@dataclass(frozen=True)
class State:
    """A model of a problem; what it predicts is worked out once, when it is asked for.

    terms: the effects. starts: wheel angle or attitude of each node. paths: for each wheel node (N,) rad, the
    angle that the wheel turned and the model with its inputs does not know. late: for each node (N,) s, by
    how much its stamps are late, where clocks are declared to differ.
    """

    problem: Problem
    terms: tuple[ModelTerm, ...] = ()
    starts: Mapping[str, NodeInitialState] = field(default_factory=dict)
    paths: Mapping[str, Array] = field(default_factory=dict)
    late: Mapping[str, Array] = field(default_factory=dict)

    def with_terms(self, terms: Sequence[ModelTerm]) -> State:
        return replace(self, terms=tuple(terms))

    def with_term(self, term: ModelTerm) -> State:
        """With one term more; it takes the place of a given one of the same effect and scope."""
        return self.with_terms([*(other for other in self.terms if other.key != term.key), term])

    def afresh(self, terms: Sequence[ModelTerm]) -> State:
        """With other terms, wheels and clocks not yet followed: where they went under these may mislead."""
        return replace(self, terms=tuple(terms), paths={}, late={})

    def part(self, samples: Mapping[str, slice]) -> State:
        """Of some samples of each node; its readings and slopes are those of this state, cut."""
        made = replace(
            self,
            problem=self.problem.part(samples),
            paths={name: path[samples[name]] for name, path in self.paths.items()},
            late={name: late[samples[name]] for name, late in self.late.items()},
        )
        known = made.__dict__
        known["effects"], known["correction"] = self.effects, self.correction
        known["readings"] = {name: one.select(samples[name]) for name, one in self.readings.items()}
        known["phase_columns"] = _cut(self.phase_columns, samples)
        if self.problem.model.inputs.clock_sigma > 0.0:
            known["late_columns"] = _cut(self.late_columns, samples)
        return made

    def at_once(self, name: str) -> bool:
        """Whether a node answers at any time only what is true at that time."""
        return not any(kind.has_memory for kind in self.effects[name])

    def start(self, node: NodeData) -> NodeInitialState:
        return self.starts.get(node.name, NodeInitialState())

    @cached_property
    def effects(self) -> Effects:
        """What each node has of the terms."""
        return {node.name: effects_on(node, self.terms) for node in self.problem.nodes}

    @cached_property
    def speed_errors(self) -> Mapping[str, SpeedError]:
        """Of each node whose gyro measured the speed."""
        return self._speed_errors(self.effects, [node.name for node in self.problem.sources])

    @cached_property
    def correction(self) -> SpeedCorrection | None:
        """Of the speed input, where gyros measured it."""
        return self.corrected(self.effects, ())

    def corrected(self, effects: Effects, changed: Collection[str]) -> SpeedCorrection | None:
        """The same with other effects; changed: the names of the nodes that have others."""
        sources = self.problem.sources
        if not sources:
            return None
        errors = {**self.speed_errors, **self._speed_errors(effects, changed)}
        return SpeedCorrection(sources[0].t, joined(sources, {name: it.value for name, it in errors.items()}))

    def _speed_errors(self, effects: Effects, names: Collection[str]) -> dict[str, SpeedError]:
        sources = self.problem.sources
        return {
            node.name: speed_error(node, effects[node.name], len(sources) == 1)
            for node in sources
            if node.name in names
        }

    @cached_property
    def readings(self) -> Mapping[str, NodeReading]:
        """What each node should have read."""
        made = {}
        for node in self.problem.nodes:
            made[node.name] = self.reading(node, self.effects[node.name].values(), self.correction)
            self._evaluated(node)
        return made

    def residual(self, node: NodeData) -> Array:
        """(6, N) of a node: measured minus predicted."""
        return node.y - stacked(self.readings[node.name])

    def input_answers(self, node: NodeData) -> InputAnswers:
        """What an error of the inputs does to a node."""
        return input_answers(node, self.readings[node.name], self.start(node))

    @cached_property
    def phase_columns(self) -> Mapping[str, Array]:
        """For each node on a wheel (6, N) per rad: change of the channels when the wheel is further round."""
        made = {}
        for node in self.problem.nodes:
            if node.on_wheel:
                path = self.paths.get(node.name, np.zeros(1))
                made[node.name] = self._slope(node, partial(self._further, node.name, path))
                self._evaluated(node)
        return made

    def forget_columns(self) -> None:
        """Its slopes go, as they will not be asked for again: of a long log they take much memory."""
        for name in ("phase_columns", "late_columns"):
            self.__dict__.pop(name, None)

    @cached_property
    def late_columns(self) -> Mapping[str, Array]:
        """(6, N) per s of each node: change of the channels when its stamps are later than they seem."""
        made = {}
        for node in self.problem.nodes:
            own = self.effects[node.name].values()
            late, early = (
                stacked(self.reading(node, own, DelayedMotion(by, self.correction)))
                for by in (_LATE_STEP, -_LATE_STEP)
            )
            made[node.name] = (late - early) / (2.0 * _LATE_STEP)
        return made

    def attitude_columns(self, node: NodeData) -> Array:
        """(3, 6, N): change of the channels for turns of a node on the body by ATTITUDE_SCALE, each axis."""
        axes = np.eye(3) * ATTITUDE_SCALE
        return np.stack([self._slope(node, partial(self._turned, node, axis)) for axis in axes])

    def reading(
        self, node: NodeData, effects: Iterable[Effect], correction: MotionCorrection | None = None
    ) -> NodeReading:
        """What one node should have read, (3, N) each, with these effects in place of its own."""
        path, late = self.paths.get(node.name, 0.0), self.late.get(node.name, 0.0)
        return node.forward.mean_reading(effects, self.start(node), path, correction, late)

    def reached(self, node: NodeData) -> SensorChain:
        """What reaches the sensor of a node, before it answers."""
        path, late = self.paths.get(node.name, 0.0), self.late.get(node.name, 0.0)
        own = list(self.effects[node.name].values())
        return node.forward.true_signals(own, self.start(node), path, self.correction, late)[0]

    def _evaluated(self, node: NodeData) -> None:
        """What is worked out of all samples at once takes much memory, and is not asked for again."""
        if not self.at_once(node.name):
            node.forward.clear_motion_cache()

    def _further(self, name: str, path: Array, by: float) -> State:
        return replace(self, paths={**self.paths, name: path + by})

    def _turned(self, node: NodeData, axis: Array, by: float) -> State:
        x, y, z = (np.array(self.start(node).attitude) + by * axis).tolist()
        return replace(self, starts={**self.starts, node.name: NodeInitialState(attitude=(x, y, z))})

    def _slope(self, node: NodeData, at: Callable[[float], State]) -> Array:
        """(6, N): change of the channels of a node along `at`, per unit; its effects stay what they are."""
        own = self.effects[node.name].values()
        ahead, behind = (stacked(at(by).reading(node, own, self.correction)) for by in (_STEP, -_STEP))
        return (ahead - behind) / (2.0 * _STEP)


def _cut(columns: Mapping[str, Array], samples: Mapping[str, slice]) -> dict[str, Array]:
    return {name: column[:, samples[name]] for name, column in columns.items()}


def stacked(reading: NodeReading) -> Array:
    """(6, N): gyro over accel."""
    return np.concatenate([reading.gyro, reading.accel])
