"""The forward model of one node: what it reads, from what the vehicle does and the effects that are there."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Chain, Effect, Geometry, Noise
from hubodo.model.inputs import Body, Inputs, MotionCorrection
from hubodo.model.motion_felt import off_axle, on_body, on_wheel
from hubodo.model.rolling import Rolling, roll
from hubodo.vehicle import NodeMount, facing_sign, side_sign

_KEPT = 3
# Samples that are worked out together where what is true of each hangs on its own time alone.
_AT_ONCE = 8192

Carried = Callable[[Array], tuple[Array, Array, Array]]
"""At t, (N,) s: angular rate rad/s, its derivative and specific force m/s² in node axes, (3, N) each."""


@dataclass(frozen=True, slots=True)
class NodeStart:
    """What is true of a node besides effects.

    angle: rad, its wheel at the log's start. attitude: rad, rotation vector of a node on the body against
    its axes.
    """

    angle: float = 0.0
    attitude: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Reading:
    """What a node reads, (3, N) each: gyro rad/s, accel m/s²; and how its wheel turned, None on the body."""

    gyro: Array
    accel: Array
    rolling: Rolling | None
    body: Body

    def part(self, samples: slice) -> Reading:
        """Of some of the samples."""
        rolling = None if self.rolling is None else self.rolling.part(samples)
        return Reading(self.gyro[:, samples], self.accel[:, samples], rolling, self.body.part(samples))


@dataclass(frozen=True, slots=True)
class Moved:
    """How the middle of a node's wheel moves, or a node elsewhere: from (body, geometry, start, phase).

    geometry: without the lever arm. rate rad/s, its derivative `slope` rad/s² and specific force m/s², (3, N)
    each in node axes.
    """

    body: Body
    geometry: Geometry
    start: NodeStart
    phase: Array | float
    rolling: Rolling | None
    rate: Array
    slope: Array
    force: Array


@dataclass
class NodeForward:
    """Evaluates one node at its own time stamps, again and again.

    inputs: of the vehicle. t: (N,) s since the log began, the stamps. mount: where the node sits.
    wheel_radius, track_width: nominal, m. power_on: s, when the node was switched on. carried: what moves
    the node where it is neither on a wheel nor on the vehicle.
    """

    inputs: Inputs
    t: Array
    mount: NodeMount
    wheel_radius: float
    track_width: float
    power_on: float = 0.0
    carried: Carried | None = None
    _bodies: dict[int, Body] = field(default_factory=dict, repr=False)
    _corrected: tuple[MotionCorrection, Body, Body] | None = field(default=None, repr=False)
    _moves: dict[bool, Moved] = field(default_factory=dict, repr=False)

    def mean(
        self,
        effects: Iterable[Effect],
        start: NodeStart,
        phase: Array | float = 0.0,
        correction: MotionCorrection | None = None,
        late: Array | float = 0.0,
    ) -> Reading:
        """The reading without anything random.

        phase: (N,) rad beside the wheel angle, see `roll`. late: (N,) s, by how much the stamps are.
        """
        effects = list(effects)
        if len(self.t) > 2 * _AT_ONCE and not any(effect.remembers for effect in effects):
            return self._in_parts(effects, start, phase, correction, late)
        chain, rolling, body = self._sensed(effects, start, phase, correction, late)
        for effect in effects:
            effect.clip(chain)
        return Reading(chain.gyro, chain.accel, rolling, body)

    def _in_parts(
        self,
        effects: list[Effect],
        start: NodeStart,
        phase: Array | float,
        correction: MotionCorrection | None,
        late: Array | float,
    ) -> Reading:
        """As `mean`, some samples after the others: what is made of them stays in the processor's cache."""
        body = self._body(effects, late, correction)
        gyro, accel = np.empty((2, 3, len(self.t)))
        angles = np.empty((3, len(self.t)))
        for first in range(0, len(self.t), _AT_ONCE):
            at = slice(first, first + _AT_ONCE)
            own = self.part(at).mean(effects, start, _of(phase, at), correction, _of(late, at))
            gyro[:, at], accel[:, at] = own.gyro, own.accel
            if own.rolling is not None:
                angles[:, at] = own.rolling.angle, own.rolling.spin, own.rolling.spin_acceleration
        return Reading(gyro, accel, None if self.mount.side is None else Rolling(*angles), body)

    def sample(
        self, effects: Iterable[Effect], start: NodeStart, noise: Noise, rng: np.random.Generator
    ) -> Reading:
        """One draw of what the node would send."""
        effects = list(effects)
        chain, rolling, body = self._wandering(effects, start, rng)
        transmit(chain, effects, noise, rng)
        return Reading(chain.gyro, chain.accel, rolling, body)

    def felt(self, effects: Iterable[Effect], start: NodeStart, rng: np.random.Generator) -> Reading:
        """One draw of what the sensor feels, before its noise and limits."""
        chain, rolling, body = self._wandering(list(effects), start, rng)
        return Reading(chain.gyro, chain.accel, rolling, body)

    def part(self, samples: slice) -> NodeForward:
        """The same of some of the stamps; what was worked out of the inputs is not worked out again."""
        bodies = {key: body.part(samples) for key, body in self._bodies.items()}
        known = {hash(body.t.tobytes()): body for body in bodies.values()}
        corrected = self._corrected
        if corrected is not None:
            by, before, after = corrected
            key = next((key for key, body in self._bodies.items() if body is before), None)
            corrected = None if key is None else (by, bodies[key], after.part(samples))
        return replace(self, t=self.t[samples], _bodies=known, _corrected=corrected, _moves={})

    def forget(self) -> None:
        """How the node moved the last time goes: for all of a long log it takes much memory."""
        self._moves.clear()

    def geometry(self, effects: Iterable[Effect]) -> Geometry:
        """Vehicle and wheel with the effects in them."""
        geometry = Geometry(self.mount.side, self.wheel_radius, self.track_width)
        for effect in effects:
            geometry = effect.shape(geometry)
        return geometry

    def place(self, chain: Chain, body: Body, rolling: Rolling | None) -> None:
        """Tell a chain how its wheel and the vehicle move, and what feeds the node."""
        chain.speed, chain.acceleration, chain.heading = body.speed, body.acceleration, body.heading
        chain.yaw_rate, chain.yaw_acceleration = body.yaw_rate, body.yaw_acceleration
        chain.supply, chain.facing = body.supply, facing_sign(self.mount.facing or "left")
        if rolling is not None:
            chain.angle, chain.spin = rolling.angle, rolling.spin
            apart = side_sign(self.mount.side or "left") * self.track_width / self.wheel_radius
            chain.spin_beside = rolling.spin + apart * body.yaw_rate

    def _wandering(
        self, effects: list[Effect], start: NodeStart, rng: np.random.Generator
    ) -> tuple[Chain, Rolling | None, Body]:
        chain, rolling, body = self._sensed(effects, start, 0.0)
        for effect in effects:
            effect.wander(chain, rng)
        return chain, rolling, body

    def _sensed(
        self,
        effects: list[Effect],
        start: NodeStart,
        phase: Array | float,
        correction: MotionCorrection | None = None,
        late: Array | float = 0.0,
    ) -> tuple[Chain, Rolling | None, Body]:
        chain, moved = self.reached(effects, start, phase, correction, late)
        chain.gyro, chain.accel = chain.rate.copy(), chain.force.copy()
        for effect in effects:
            effect.respond(chain)
        for effect in effects:
            effect.offset(chain)
        return chain, moved.rolling, moved.body

    def reached(
        self,
        effects: list[Effect],
        start: NodeStart,
        phase: Array | float = 0.0,
        correction: MotionCorrection | None = None,
        late: Array | float = 0.0,
    ) -> tuple[Chain, Moved]:
        """What reaches the sensor, before it answers; and how the node moves."""
        body, geometry = self._body(effects, late, correction), self.geometry(effects)
        moved = self._moved(body, replace(geometry, lever_arm=(0.0, 0.0, 0.0)), start, phase, correction)
        rolling, rate, force = moved.rolling, moved.rate, moved.force
        if any(geometry.lever_arm):
            force = force + off_axle(rate, moved.slope, geometry.lever_arm)
        chain = Chain(body.t - self.power_on, body.temperature, rate, moved.slope, force, rate, force)
        self.place(chain, body, rolling)
        for effect in effects:
            effect.mount(chain)
        for effect in effects:
            effect.low_pass(chain)
        return chain, moved

    def _moved(
        self,
        body: Body,
        geometry: Geometry,
        start: NodeStart,
        phase: Array | float,
        correction: MotionCorrection | None,
    ) -> Moved:
        """How the node moves; the same again is not computed again, as most effects change nothing of it.

        With a correction and without are kept apart: where gyros measured the speed both come in turns.
        """
        last = self._moves.get(correction is not None)
        if (
            last
            and (last.body is body and last.phase is phase)
            and (last.geometry, last.start) == (geometry, start)
        ):
            return last
        rolling = None
        if self.carried is not None:
            rate, slope, force = self.carried(body.t)
        elif geometry.side is None:
            rate, slope, force = on_body(body, geometry, start.attitude, self.inputs.earth)
        else:
            rolling = roll(body, geometry, start.angle, phase)
            rate, slope, force = on_wheel(body, rolling, geometry, facing_sign(self.mount.facing or "left"))
        made = Moved(body, geometry, start, phase, rolling, rate, slope, force)
        self._moves[correction is not None] = made
        return made

    def _body(self, effects: list[Effect], late: Array | float, correction: MotionCorrection | None) -> Body:
        """The vehicle at the true times of the samples, corrected; what comes again is not computed again."""
        body = self._uncorrected(effects, late)
        if correction is None:
            return body
        last = self._corrected
        if last is None or last[0] is not correction or last[1] is not body:
            last = self._corrected = correction, body, correction.apply(body)
        return last[2]

    def _uncorrected(self, effects: list[Effect], late: Array | float) -> Body:
        t = self.t - late if np.any(late) else self.t
        for effect in effects:
            t = effect.true_time(t)
        key = hash(t.tobytes())
        made = self._bodies.get(key)
        if made is None:
            while len(self._bodies) >= _KEPT:
                self._bodies.pop(next(iter(self._bodies)))
            made = self._bodies[key] = self.inputs.at(t)
        return made


def _of(value: Array | float, samples: slice) -> Array | float:
    """Of some samples; one value for all stays."""
    return value[samples] if isinstance(value, np.ndarray) and value.size > 1 else value


def transmit(chain: Chain, effects: Iterable[Effect], noise: Noise, rng: np.random.Generator) -> None:
    """From what the sensor feels to what is sent: noise, wild samples, limits, steps, repeats."""
    effects = list(effects)
    chain.gyro += noise.gyro * rng.standard_normal(chain.gyro.shape)
    chain.accel += noise.accel * rng.standard_normal(chain.accel.shape)
    for effect in effects:
        effect.scatter(chain, noise, rng)
    for effect in effects:
        effect.clip(chain)
    for effect in effects:
        effect.digitize(chain)
    for effect in effects:
        effect.repeat(chain, rng)
