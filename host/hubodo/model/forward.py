"""The forward model of one node: what it reads, from what the vehicle does and the effects that are there."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.base import Chain, Effect, Geometry, Noise
from hubodo.model.inputs import Body, Earth, Inputs, MotionCorrection
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

    def geometry(self, effects: Iterable[Effect]) -> Geometry:
        """Vehicle and wheel with the effects in them."""
        geometry = Geometry(self.mount.side, self.wheel_radius, self.track_width)
        for effect in effects:
            geometry = effect.shape(geometry)
        return geometry

    def place(self, chain: Chain, body: Body, rolling: Rolling | None) -> None:
        """Tell a chain how its wheel and the vehicle move."""
        chain.speed, chain.acceleration, chain.heading = body.speed, body.acceleration, body.heading
        chain.yaw_rate, chain.yaw_acceleration = body.yaw_rate, body.yaw_acceleration
        chain.facing = facing_sign(self.mount.facing or "left")
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
            force = force + _off_axle(rate, moved.slope, geometry.lever_arm)
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
            rate, slope, force = _on_body(body, geometry, start, self.inputs.earth)
        else:
            rolling = roll(body, geometry, start.angle, phase)
            rate, slope, force = _on_wheel(body, rolling, geometry, facing_sign(self.mount.facing or "left"))
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


def _on_wheel(body: Body, rolling: Rolling, geometry: Geometry, facing: float) -> tuple[Array, Array, Array]:
    """Angular rate, its derivative and specific force in node axes, (3, N) each.

    Omega = theta' a + r z_b; f_s = C_sb (a_h + g z) + Omega' x rho + Omega x (Omega x rho).
    """
    side = side_sign(geometry.side or "left")
    lean, upright = side * np.sin(geometry.camber), np.cos(geometry.camber)
    cos, sin = np.cos(rolling.angle), np.sin(rolling.angle)
    r, r_slope = body.yaw_rate, body.yaw_acceleration
    rate, slope, force = (np.empty((3, len(r))) for _ in range(3))
    across, across_slope = upright * r, upright * r_slope
    turning = across * rolling.spin
    rate[0], rate[1] = across * cos, (-facing) * across * sin
    rate[2] = facing * (rolling.spin + lean * r)
    slope[0] = across_slope * cos - turning * sin
    slope[1] = -facing * (across_slope * sin + turning * cos)
    slope[2] = facing * (rolling.spin_acceleration + lean * r_slope)
    hub_y = 0.5 * side * geometry.track_width - side * geometry.radius * np.sin(geometry.camber)
    hub_y -= geometry.aside
    ahead = body.acceleration - r_slope * hub_y + STANDARD_GRAVITY * np.sin(geometry.grade)
    aside = r * (body.speed - r * hub_y)
    upwards = STANDARD_GRAVITY * np.cos(geometry.grade)
    up = upright * upwards - lean * aside
    force[0] = cos * up + sin * ahead
    force[1] = facing * (cos * ahead - sin * up)
    force[2] = facing * (upright * aside + lean * upwards)
    return rate, slope, force


def _off_axle(rate: Array, slope: Array, arm: tuple[float, float, float]) -> Array:
    """Omega' x rho + Omega (Omega . rho) - rho Omega²."""
    x, y, z = arm
    along = x * rate[0] + y * rate[1] + z * rate[2]
    square = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
    return np.stack(
        [
            slope[1] * z - slope[2] * y + rate[0] * along - x * square,
            slope[2] * x - slope[0] * z + rate[1] * along - y * square,
            slope[0] * y - slope[1] * x + rate[2] * along - z * square,
        ]
    )


def _on_body(
    body: Body, geometry: Geometry, start: NodeStart, earth: Earth | None
) -> tuple[Array, Array, Array]:
    """The same for a node fixed to the body at its origin, turned by start.attitude against its axes."""
    zero = np.zeros_like(body.speed)
    rate = np.stack([zero, zero, body.yaw_rate])
    slope = np.stack([zero, zero, body.yaw_acceleration])
    if earth is not None:
        turning, turning_slope = earth.rate(body.heading, body.yaw_rate)
        rate, slope = rate + turning, slope + turning_slope
    force = np.stack(
        [
            body.acceleration
            + body.yaw_acceleration * geometry.aside
            + STANDARD_GRAVITY * np.sin(geometry.grade),
            body.yaw_rate * (body.speed + body.yaw_rate * geometry.aside),
            zero + STANDARD_GRAVITY * np.cos(geometry.grade),
        ]
    )
    turn = Rotation.from_rotvec(start.attitude).as_matrix().T
    return turn @ rate, turn @ slope, turn @ force
