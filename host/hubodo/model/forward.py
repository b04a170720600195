"""Forward model of one node: its readings, from the motion of the vehicle and the effects."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Effect
from hubodo.effects.sensor_chain import Geometry, Noise, SensorChain
from hubodo.model.inputs import BodyMotion, MotionCorrection, MotionInputs
from hubodo.model.rolling import WheelRotation, wheel_rotation
from hubodo.model.true_motion import lever_arm_force, motion_on_body, motion_on_wheel
from hubodo.vehicle import NodeMount, facing_sign, side_sign

_CACHED_BODIES = 3  # cached motions of the vehicle, one per set of time stamps
# Number of samples evaluated at once if no effect has memory; their arrays fit into the processor's cache.
_BLOCK_SAMPLES = 8192

CarriedMotion = Callable[[Array], tuple[Array, Array, Array]]
"""Function of t, (N,) s, that returns angular rate in rad/s, its derivative and specific force in m/s², (3,
N) each in node axes."""


@dataclass(frozen=True, slots=True)
class NodeInitialState:
    """Initial state of a node.

    wheel_angle: rad, at the start of the log. attitude: rad, rotation vector of a node on the body relative
    to the body axes.
    """

    wheel_angle: float = 0.0
    attitude: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class NodeReading:
    """Readings of a node: `gyro` in rad/s and `accel` in m/s², (3, N) each, with the motion that caused them.

    rolling: rotation of the wheel; None on the body. body: motion of the vehicle.
    """

    gyro: Array
    accel: Array
    rolling: WheelRotation | None
    body: BodyMotion

    def select(self, samples: slice) -> NodeReading:
        """Return the readings of a slice of the samples."""
        rolling = None if self.rolling is None else self.rolling.select(samples)
        return NodeReading(self.gyro[:, samples], self.accel[:, samples], rolling, self.body.select(samples))


@dataclass(frozen=True, slots=True)
class TrueMotion:
    """True motion of a node without lever arm, stored with the arguments that determine it.

    rate in rad/s, rate_derivative in rad/s² and specific force in m/s² are (3, N) in node axes; `geometry`
    has no lever arm. `arm_forces` stores the force that the first lever arm added, which most effects leave
    unchanged.
    """

    body: BodyMotion
    geometry: Geometry
    start: NodeInitialState
    angle_error: Array | float
    rolling: WheelRotation | None
    rate: Array
    rate_derivative: Array
    force: Array
    arm_forces: dict[tuple[float, float, float], Array] = field(default_factory=dict)

    def force_at(self, arm: tuple[float, float, float]) -> Array:
        """Return the specific force at the end of a lever arm in m, (3, N) m/s²."""
        if not any(arm):
            return self.force
        added = self.arm_forces.get(arm)
        if added is None:
            added = lever_arm_force(self.rate, self.rate_derivative, arm)
            if not self.arm_forces:
                self.arm_forces[arm] = added
        return np.asarray(self.force + added)


@dataclass
class NodeModel:
    """Forward model of one node at its time stamps, with caches for repeated evaluation.

    Attributes
    ----------
    inputs : motion of the vehicle.
    stamps : (N,) s since the start of the log, time stamps of the samples.
    mount : wheel and orientation of the node.
    wheel_radius, track_width : m, nominal.
    power_on : s since the start of the log, time at which the node was switched on.
    carried_motion : motion of a node that is neither on a wheel nor on the vehicle.
    """

    inputs: MotionInputs
    stamps: Array
    mount: NodeMount
    wheel_radius: float
    track_width: float
    power_on: float = 0.0
    carried_motion: CarriedMotion | None = None
    _cached_bodies: dict[int, BodyMotion] = field(default_factory=dict, repr=False)
    _cached_correction: tuple[MotionCorrection, BodyMotion, BodyMotion] | None = field(
        default=None, repr=False
    )
    _cached_motion: dict[bool, TrueMotion] = field(default_factory=dict, repr=False)

    def mean_reading(
        self,
        effects: Iterable[Effect],
        start: NodeInitialState,
        angle_error: Array | float = 0.0,
        correction: MotionCorrection | None = None,
        stamp_delay: Array | float = 0.0,
    ) -> NodeReading:
        """Return the readings without noise.

        Parameters
        ----------
        effects : effects of the node.
        start : initial state.
        angle_error : (N,) rad, added to the wheel angle, see `wheel_rotation`.
        correction : correction of the motion of the vehicle.
        stamp_delay : (N,) s, delay of the time stamps.
        """
        effects = list(effects)
        if len(self.stamps) > 2 * _BLOCK_SAMPLES and not any(effect.has_memory for effect in effects):
            return self._mean_in_blocks(effects, start, angle_error, correction, stamp_delay)
        chain, rolling, body = self._measure(effects, start, angle_error, correction, stamp_delay)
        for effect in effects:
            effect.clip_readings(chain)
        return NodeReading(chain.gyro, chain.accel, rolling, body)

    def _mean_in_blocks(
        self,
        effects: list[Effect],
        start: NodeInitialState,
        angle_error: Array | float,
        correction: MotionCorrection | None,
        stamp_delay: Array | float,
    ) -> NodeReading:
        """Return the same as `mean_reading`, evaluated in blocks of samples."""
        body = self._corrected_body(effects, stamp_delay, correction)
        gyro, accel = np.empty((2, 3, len(self.stamps)))
        angles = np.empty((3, len(self.stamps)))
        for first in range(0, len(self.stamps), _BLOCK_SAMPLES):
            block = slice(first, first + _BLOCK_SAMPLES)
            reading = self.select(block).mean_reading(
                effects, start, _select(angle_error, block), correction, _select(stamp_delay, block)
            )
            gyro[:, block], accel[:, block] = reading.gyro, reading.accel
            if reading.rolling is not None:
                angles[:, block] = (
                    reading.rolling.angle,
                    reading.rolling.spin,
                    reading.rolling.spin_acceleration,
                )
        return NodeReading(gyro, accel, None if self.mount.side is None else WheelRotation(*angles), body)

    def draw_reading(
        self, effects: Iterable[Effect], start: NodeInitialState, noise: Noise, rng: np.random.Generator
    ) -> NodeReading:
        """Return one random draw of the readings that the node sends."""
        effects = list(effects)
        chain, rolling, body = self._with_random_walk(effects, start, rng)
        add_noise_and_limits(chain, effects, noise, rng)
        return NodeReading(chain.gyro, chain.accel, rolling, body)

    def draw_noise_free(
        self, effects: Iterable[Effect], start: NodeInitialState, rng: np.random.Generator
    ) -> NodeReading:
        """Return one random draw of the readings before white noise, range and resolution."""
        chain, rolling, body = self._with_random_walk(list(effects), start, rng)
        return NodeReading(chain.gyro, chain.accel, rolling, body)

    def select(self, samples: slice) -> NodeModel:
        """Return the model at a slice of the time stamps; cached motions are kept."""
        bodies = {key: body.select(samples) for key, body in self._cached_bodies.items()}
        known = {hash(body.t.tobytes()): body for body in bodies.values()}
        corrected = self._cached_correction
        if corrected is not None:
            applied, before, after = corrected
            key = next((key for key, body in self._cached_bodies.items() if body is before), None)
            corrected = None if key is None else (applied, bodies[key], after.select(samples))
        return replace(
            self,
            stamps=self.stamps[samples],
            _cached_bodies=known,
            _cached_correction=corrected,
            _cached_motion={},
        )

    def clear_motion_cache(self) -> None:
        """Clear the cached motion of the node, which is large for a long log."""
        self._cached_motion.clear()

    def geometry(self, effects: Iterable[Effect]) -> Geometry:
        """Return the geometry of vehicle and wheel with the effects."""
        geometry = Geometry(self.mount.side, self.wheel_radius, self.track_width)
        for effect in effects:
            geometry = effect.adjust_geometry(geometry)
        return geometry

    def set_motion(self, chain: SensorChain, body: BodyMotion, rolling: WheelRotation | None) -> None:
        """Set the motion of vehicle and wheel, and the supply, in a sensor chain."""
        chain.speed, chain.acceleration, chain.heading = body.speed, body.acceleration, body.heading
        chain.yaw_rate, chain.yaw_acceleration = body.yaw_rate, body.yaw_acceleration
        chain.supply, chain.facing = body.supply, facing_sign(self.mount.facing or "left")
        if rolling is not None:
            chain.angle, chain.spin = rolling.angle, rolling.spin
            spin_per_yaw_rate = side_sign(self.mount.side or "left") * self.track_width / self.wheel_radius
            chain.opposite_spin = rolling.spin + spin_per_yaw_rate * body.yaw_rate

    def _with_random_walk(
        self, effects: list[Effect], start: NodeInitialState, rng: np.random.Generator
    ) -> tuple[SensorChain, WheelRotation | None, BodyMotion]:
        """Return the chain with one draw of the random walks, before white noise."""
        chain, rolling, body = self._measure(effects, start, 0.0)
        for effect in effects:
            effect.add_random_walk(chain, rng)
        return chain, rolling, body

    def _measure(
        self,
        effects: list[Effect],
        start: NodeInitialState,
        angle_error: Array | float,
        correction: MotionCorrection | None = None,
        stamp_delay: Array | float = 0.0,
    ) -> tuple[SensorChain, WheelRotation | None, BodyMotion]:
        """Return the chain with noise-free, unlimited readings."""
        chain, motion = self.true_signals(effects, start, angle_error, correction, stamp_delay)
        chain.gyro, chain.accel = chain.rate.copy(), chain.force.copy()
        for effect in effects:
            effect.add_scale_errors(chain)
        for effect in effects:
            effect.add_offsets(chain)
        return chain, motion.rolling, motion.body

    def true_signals(
        self,
        effects: list[Effect],
        start: NodeInitialState,
        angle_error: Array | float = 0.0,
        correction: MotionCorrection | None = None,
        stamp_delay: Array | float = 0.0,
    ) -> tuple[SensorChain, TrueMotion]:
        """Return the chain with true rate and force at the sensor, and the motion of the node."""
        body, geometry = self._corrected_body(effects, stamp_delay, correction), self.geometry(effects)
        motion = self._node_motion(
            body, replace(geometry, lever_arm=(0.0, 0.0, 0.0)), start, angle_error, correction
        )
        rolling, rate, force = motion.rolling, motion.rate, motion.force_at(geometry.lever_arm)
        chain = SensorChain(
            body.t - self.power_on, body.temperature, rate, motion.rate_derivative, force, rate, force
        )
        self.set_motion(chain, body, rolling)
        for effect in effects:
            effect.rotate_into_node(chain)
        for effect in effects:
            effect.low_pass_rate(chain)
        return chain, motion

    def _node_motion(
        self,
        body: BodyMotion,
        geometry: Geometry,
        start: NodeInitialState,
        angle_error: Array | float,
        correction: MotionCorrection | None,
    ) -> TrueMotion:
        """Return the motion of the node, cached: most effects leave it unchanged.

        Motions with and without a correction are cached separately, because fits alternate between them.
        """
        last = self._cached_motion.get(correction is not None)
        if (
            last
            and (last.body is body and last.angle_error is angle_error)
            and (last.geometry, last.start) == (geometry, start)
        ):
            return last
        rolling = None
        if self.carried_motion is not None:
            rate, rate_derivative, force = self.carried_motion(body.t)
        elif geometry.side is None:
            rate, rate_derivative, force = motion_on_body(body, geometry, start.attitude, self.inputs.earth)
        else:
            rolling = wheel_rotation(body, geometry, start.wheel_angle, angle_error)
            rate, rate_derivative, force = motion_on_wheel(
                body, rolling, geometry, facing_sign(self.mount.facing or "left")
            )
        motion = TrueMotion(body, geometry, start, angle_error, rolling, rate, rate_derivative, force)
        self._cached_motion[correction is not None] = motion
        return motion

    def _corrected_body(
        self, effects: list[Effect], stamp_delay: Array | float, correction: MotionCorrection | None
    ) -> BodyMotion:
        """Return the corrected motion of the vehicle at the true sampling times, cached."""
        body = self._body(effects, stamp_delay)
        if correction is None:
            return body
        last = self._cached_correction
        if last is None or last[0] is not correction or last[1] is not body:
            last = self._cached_correction = correction, body, correction.apply(body)
        return last[2]

    def _body(self, effects: list[Effect], stamp_delay: Array | float) -> BodyMotion:
        """Return the motion of the vehicle at the true sampling times, cached."""
        t = self.stamps - stamp_delay if np.any(stamp_delay) else self.stamps
        for effect in effects:
            t = effect.true_time(t)
        key = self._stamps_key if t is self.stamps else hash(t.tobytes())
        body = self._cached_bodies.pop(key, None)
        if body is None:
            while len(self._cached_bodies) >= _CACHED_BODIES:
                self._cached_bodies.pop(next(iter(self._cached_bodies)))
            body = self.inputs.at(t)
        # The last used one is last in order, so that the first is the one to discard.
        self._cached_bodies[key] = body
        return body

    @cached_property
    def _stamps_key(self) -> int:
        return hash(self.stamps.tobytes())


def _select(value: Array | float, samples: slice) -> Array | float:
    """Return the values of a slice of samples; a scalar is returned unchanged."""
    return value[samples] if isinstance(value, np.ndarray) and value.size > 1 else value


def add_noise_and_limits(
    chain: SensorChain, effects: Iterable[Effect], noise: Noise, rng: np.random.Generator
) -> None:
    """Apply white noise, outliers, clipping, quantization and repeated samples to the readings of a chain."""
    effects = list(effects)
    chain.gyro += noise.gyro * rng.standard_normal(chain.gyro.shape)
    chain.accel += noise.accel * rng.standard_normal(chain.accel.shape)
    for effect in effects:
        effect.add_outliers(chain, noise, rng)
    for effect in effects:
        effect.clip_readings(chain)
    for effect in effects:
        effect.quantize_readings(chain)
    for effect in effects:
        effect.repeat_samples(chain, rng)
