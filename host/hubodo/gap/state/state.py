"""A model state and its predicted readings: terms, start of each node, phase offset of each wheel."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.effects.sensor_chain import SensorChain
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.state.measured_speed import SpeedError, compute_speed_error, correct_measured_speed
from hubodo.gap.state.noise import InputSensitivity, compute_input_sensitivity
from hubodo.gap.state.terms import ModelTerm, effects_on_node, terms_of_model
from hubodo.model.forward import NodeInitialState, NodeReading
from hubodo.model.inputs import DelayedMotion, MotionCorrection, SpeedCorrection
from hubodo.vehicle import facing_sign

# rad, or units of ATTITUDE_SCALE; half of a central difference. Its cube is below the rounding of a log.
_ANGLE_STEP = 1e-3
# s; half of a central difference for time stamps.
_DELAY_STEP = 1e-4
# rad; usual error of the attitude of a node on the body.
ATTITUDE_SCALE = 0.05

Effects = Mapping[str, Mapping[type[Effect], Effect]]
"""Effects of each node, by its name and then by the class of the effect."""


@dataclass(frozen=True)
class State:
    """A model of a problem; predictions are computed once, on first use.

    terms: effects of the model
    starts: initial wheel angle or attitude of each node
    phase_offsets: for each wheel node (N,) rad, the tracked wheel angle minus the angle integrated from the
        inputs
    stamp_delays: for each node (N,) s, the delay of its time stamps, if clocks are declared to differ
    measured_offsets: for each wheel whose gyro measured the speed (N,) rad, the tracked wheel angle minus the
        angle integrated from that speed as it was measured, before any correction
    has_steady_wheels: True if a trend of a wheel's phase is treated as an error of the model, not as random
        walk
    has_correlated_noise: True if weights are estimated with the correlation of the noise
    """

    problem: Problem
    terms: tuple[ModelTerm, ...] = ()
    starts: Mapping[str, NodeInitialState] = field(default_factory=dict)
    phase_offsets: Mapping[str, Array] = field(default_factory=dict)
    stamp_delays: Mapping[str, Array] = field(default_factory=dict)
    measured_offsets: Mapping[str, Array] = field(default_factory=dict)
    has_steady_wheels: bool = False
    has_correlated_noise: bool = False

    def with_terms(self, terms: Sequence[ModelTerm]) -> State:
        return replace(self, terms=tuple(terms))

    def with_term(self, term: ModelTerm) -> State:
        """Return a copy with one more term; it replaces a model-file term of the same effect and scope."""
        return self.with_terms([*(other for other in self.terms if other.key != term.key), term])

    def without_terms(self, keys: Collection[tuple[str, str]]) -> State:
        """Return a copy without some terms, given by effect and scope, and with untracked wheels and clocks.

        Where a term refined an effect of the model file, the value of the file returns.
        """
        given = [term for term in terms_of_model(self.problem.model) if term.key in keys]
        return self.reset_with_terms([*(term for term in self.terms if term.key not in keys), *given])

    def reset_with_terms(self, terms: Sequence[ModelTerm]) -> State:
        """Return a copy with the given terms, and with wheels and clocks not yet tracked.

        Values tracked with the old terms may be wrong for the new ones.
        """
        return replace(self, terms=tuple(terms), phase_offsets={}, stamp_delays={}, measured_offsets={})

    def select(self, samples: Mapping[str, slice]) -> State:
        """Return a copy with some samples of each node; cached predictions are sliced."""
        selected = replace(
            self,
            problem=self.problem.select(samples),
            phase_offsets={name: offset[samples[name]] for name, offset in self.phase_offsets.items()},
            stamp_delays={name: delay[samples[name]] for name, delay in self.stamp_delays.items()},
            measured_offsets={name: offset[samples[name]] for name, offset in self.measured_offsets.items()},
        )
        cache = selected.__dict__
        cache["effects"], cache["speed_correction"] = self.effects, self.speed_correction
        cache["predictions"] = {
            name: reading.select(samples[name]) for name, reading in self.predictions.items()
        }
        cache["phase_columns"] = _slice_columns(self.phase_columns, samples)
        if self.problem.model.inputs.clock_sigma > 0.0:
            cache["delay_columns"] = _slice_columns(self.delay_columns, samples)
        return selected

    def is_memoryless(self, name: str) -> bool:
        """Return True if the readings of a node depend on the present motion only."""
        return not any(kind.has_memory for kind in self.effects[name])

    def start_of(self, node: NodeData) -> NodeInitialState:
        return self.starts.get(node.name, NodeInitialState())

    @cached_property
    def effects(self) -> Effects:
        """Return the effects of each node."""
        return {node.name: effects_on_node(node, self.terms) for node in self.problem.nodes}

    @cached_property
    def speed_errors(self) -> Mapping[str, SpeedError]:
        """Return the speed error of each node whose gyro measured the speed."""
        return self._speed_errors(self.effects, [node.name for node in self.problem.speed_source_nodes])

    @cached_property
    def speed_correction(self) -> SpeedCorrection | None:
        """Return the correction of the speed input if gyros measured it."""
        return self.correct_speed(self.effects, ())

    def correct_speed(self, effects: Effects, changed: Collection[str]) -> SpeedCorrection | None:
        """Return the speed correction with other effects; `changed` names the nodes whose effects differ."""
        sources = self.problem.speed_source_nodes
        if not sources:
            return None
        errors = {**self.speed_errors, **self._speed_errors(effects, changed)}
        return SpeedCorrection(sources[0].t, correct_measured_speed(self.problem, errors))

    def _speed_errors(self, effects: Effects, names: Collection[str]) -> dict[str, SpeedError]:
        sources = self.problem.speed_source_nodes
        return {
            node.name: compute_speed_error(
                node, effects[node.name], len(sources) == 1, self._measured_offset(node, effects[node.name])
            )
            for node in sources
            if node.name in names
        }

    def _measured_offset(self, node: NodeData, effects: Mapping[type[Effect], Effect]) -> Array | float:
        """Return `measured_offsets` of a node with these effects, (N,) rad.

        The tracked angle follows gravity: a node rotated about its axle turns it back. Without that, the
        rotation seems to change the speed, and a fit would determine what no log shows.
        """
        offset = self.measured_offsets.get(node.name, 0.0)
        rotation, tracked = (
            sum(effect.axle_rotation() for effect in some.values())
            for some in (effects, self.effects[node.name])
        )
        return offset - facing_sign(node.mount.facing or "left") * (rotation - tracked)

    @cached_property
    def predictions(self) -> Mapping[str, NodeReading]:
        """Return the predicted readings of each node."""
        predictions = {}
        for node in self.problem.nodes:
            predictions[node.name] = self.predict(
                node, self.effects[node.name].values(), self.speed_correction
            )
            self._release_memory(node)
        return predictions

    def residual(self, node: NodeData) -> Array:
        """Return measured minus predicted readings of a node, (6, N)."""
        return node.y - stack_channels(self.predictions[node.name])

    def input_sensitivity(self, node: NodeData) -> InputSensitivity:
        """Return the change of a node's readings for errors of the inputs."""
        return compute_input_sensitivity(node, self.predictions[node.name], self.start_of(node))

    @cached_property
    def phase_columns(self) -> Mapping[str, Array]:
        """Return for each wheel node the change of its channels per rad of wheel angle, (6, N)."""
        columns = {}
        for node in self.problem.nodes:
            if node.on_wheel:
                offset = self.phase_offsets.get(node.name, np.zeros(1))
                columns[node.name] = self._differentiate(
                    node, partial(self._advance_wheel, node.name, offset)
                )
                self._release_memory(node)
        return columns

    def drop_columns(self) -> None:
        """Discard the cached phase derivatives, which are large for a long log."""
        for name in ("phase_columns", "delay_columns"):
            self.__dict__.pop(name, None)

    @cached_property
    def delay_columns(self) -> Mapping[str, Array]:
        """Return for each node the change of its channels per s of stamp delay, (6, N)."""
        columns = {}
        for node in self.problem.nodes:
            effects = self.effects[node.name].values()
            late, early = (
                stack_channels(self.predict(node, effects, DelayedMotion(by, self.speed_correction)))
                for by in (_DELAY_STEP, -_DELAY_STEP)
            )
            columns[node.name] = (late - early) / (2.0 * _DELAY_STEP)
        return columns

    def attitude_columns(self, node: NodeData) -> Array:
        """Return the change of a node's channels, (3, 6, N), per ATTITUDE_SCALE about each axis."""
        axes = np.eye(3) * ATTITUDE_SCALE
        return np.stack([self._differentiate(node, partial(self._rotate_node, node, axis)) for axis in axes])

    def predict(
        self, node: NodeData, effects: Iterable[Effect], correction: MotionCorrection | None = None
    ) -> NodeReading:
        """Predict the readings of one node, (3, N) each, with these effects instead of its own."""
        offset, delay = self.phase_offsets.get(node.name, 0.0), self.stamp_delays.get(node.name, 0.0)
        return node.forward.mean_reading(effects, self.start_of(node), offset, correction, delay)

    def sensor_chain(self, node: NodeData) -> SensorChain:
        """Return the physical input of a node's sensor, before the sensor responds."""
        offset, delay = self.phase_offsets.get(node.name, 0.0), self.stamp_delays.get(node.name, 0.0)
        effects = list(self.effects[node.name].values())
        return node.forward.true_signals(effects, self.start_of(node), offset, self.speed_correction, delay)[
            0
        ]

    def _release_memory(self, node: NodeData) -> None:
        """Discard the intermediate results of a node with memory, which span all samples."""
        if not self.is_memoryless(node.name):
            node.forward.clear_motion_cache()

    def _advance_wheel(self, name: str, phase_offset: Array, angle: float) -> State:
        return replace(self, phase_offsets={**self.phase_offsets, name: phase_offset + angle})

    def _rotate_node(self, node: NodeData, axis: Array, angle: float) -> State:
        x, y, z = (np.array(self.start_of(node).attitude) + angle * axis).tolist()
        return replace(self, starts={**self.starts, node.name: NodeInitialState(attitude=(x, y, z))})

    def _differentiate(self, node: NodeData, shifted: Callable[[float], State]) -> Array:
        """Return the change of a node's channels, (6, N), per unit of the argument of `shifted`."""
        effects = self.effects[node.name].values()
        ahead, behind = (
            stack_channels(shifted(by).predict(node, effects, self.speed_correction))
            for by in (_ANGLE_STEP, -_ANGLE_STEP)
        )
        return (ahead - behind) / (2.0 * _ANGLE_STEP)


def _slice_columns(columns: Mapping[str, Array], samples: Mapping[str, slice]) -> dict[str, Array]:
    return {name: column[:, samples[name]] for name, column in columns.items()}


def stack_channels(reading: NodeReading) -> Array:
    """Stack gyro over accelerometer readings, (6, N)."""
    return np.concatenate([reading.gyro, reading.accel])
