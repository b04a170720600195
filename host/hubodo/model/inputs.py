"""What drives the forward model, as functions of time: speed, yaw rate, and what surrounds its nodes."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE
from hubodo.effects.base import REFERENCE_CELSIUS, REFERENCE_VOLTS
from hubodo.smoothing_spline import SmoothingSpline


@dataclass(frozen=True, slots=True)
class Body:
    """Motion of the body origin at N times, each (N,).

    speed m/s, acceleration m/s², jerk m/s³, distance m from the log's start; yaw_rate rad/s,
    yaw_acceleration rad/s², yaw_jerk rad/s³, heading rad from the log's start; temperature °C; supply V.
    """

    t: Array
    speed: Array
    acceleration: Array
    jerk: Array
    distance: Array
    yaw_rate: Array
    yaw_acceleration: Array
    yaw_jerk: Array
    heading: Array
    temperature: Array
    supply: Array

    def part(self, samples: slice) -> Body:
        """Of some of the times."""
        return Body(*(getattr(self, one.name)[samples] for one in fields(self)))


@dataclass(frozen=True, slots=True)
class Earth:
    """The Earth turns under a bench.

    latitude: rad. azimuth: rad, of the body's x axis at heading 0, clockwise from north.
    """

    latitude: float
    azimuth: float = 0.0

    def rate(self, heading: Array, yaw_rate: Array) -> tuple[Array, Array]:
        """Its angular rate in body axes and the derivative of that, (3, N) each."""
        across, up = EARTH_RATE * np.cos(self.latitude), EARTH_RATE * np.sin(self.latitude)
        north = self.azimuth - heading
        zero = np.zeros_like(heading)
        rate = np.stack([across * np.cos(north), across * np.sin(north), zero + up])
        return rate, np.stack([yaw_rate * rate[1], -yaw_rate * rate[0], zero])


@dataclass(frozen=True, slots=True)
class Trace:
    """What is told now and then: values at times t, s since the log began, (M,) each."""

    t: Array
    values: Array

    def at(self, t: Array) -> Array:
        """(N,) at other times; before the first and after the last as there."""
        if len(self.t) == 1:
            return np.broadcast_to(self.values, t.shape)
        return np.interp(t, self.t, self.values)

    @staticmethod
    def steady(value: float) -> Trace:
        """The same at all times."""
        return Trace(np.zeros(1), np.full(1, value))


_ROOM = Trace.steady(REFERENCE_CELSIUS)
_BATTERY = Trace.steady(REFERENCE_VOLTS)


@dataclass(frozen=True)
class Inputs:
    """speed: m/s and yaw_rate: rad/s of the body origin. temperature: °C and supply: V, of the nodes.

    earth: only for nodes on the body, where an experiment is long and still enough to see it.
    """

    speed: SmoothingSpline
    yaw_rate: SmoothingSpline
    temperature: Trace = _ROOM
    supply: Trace = _BATTERY
    earth: Earth | None = None

    def at(self, t: Array) -> Body:
        """Everything at times t, (N,) s since the log began."""
        around = self.temperature.at(t), self.supply.at(t)
        return Body(t, *self.speed.evaluate(t), *self.yaw_rate.evaluate(t), *around)


class MotionCorrection(Protocol):
    """What changes the motion that the inputs give."""

    def apply(self, body: Body) -> Body: ...


@dataclass(frozen=True, slots=True)
class Later:
    """Stamps that are late by so many s, few enough that the motion bends little meanwhile.

    before: what is applied first.
    """

    by: float
    before: MotionCorrection | None = None

    def apply(self, body: Body) -> Body:
        """The body where it was `by` before."""
        if self.before is not None:
            body = self.before.apply(body)
        return replace(
            body,
            speed=body.speed - self.by * body.acceleration,
            acceleration=body.acceleration - self.by * body.jerk,
            distance=body.distance - self.by * body.speed,
            yaw_rate=body.yaw_rate - self.by * body.yaw_acceleration,
            yaw_acceleration=body.yaw_acceleration - self.by * body.yaw_jerk,
            heading=body.heading - self.by * body.yaw_rate,
        )


@dataclass(frozen=True, slots=True)
class Driven:
    """A little more speed, m/s, and acceleration, m/s², at all times alike. before: what is applied first."""

    speed: float = 0.0
    acceleration: float = 0.0
    before: MotionCorrection | None = None

    def apply(self, body: Body) -> Body:
        """The body driven so; the way that it has gone stays what it is."""
        if self.before is not None:
            body = self.before.apply(body)
        return replace(
            body, speed=body.speed + self.speed, acceleration=body.acceleration + self.acceleration
        )


@dataclass(frozen=True)
class SpeedCorrection:
    """What is to be added to a speed input that was itself measured: m/s at times t, s, (M,) each."""

    t: Array
    speed: Array

    @cached_property
    def acceleration(self) -> Array:
        """(M,) m/s² that go with it."""
        return np.asarray(np.gradient(self.speed, self.t))

    @cached_property
    def distance(self) -> Array:
        """(M,) m that come of it."""
        step = np.diff(self.t)
        return np.concatenate([[0.0], np.cumsum(0.5 * step * (self.speed[1:] + self.speed[:-1]))])

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Speed, acceleration and distance at other times, (N,) each."""
        made = self.speed, self.acceleration, self.distance
        first = int(np.searchsorted(self.t, t[0]))
        if np.array_equal(t, self.t[first : first + len(t)]):
            speed, acceleration, distance = (one[first : first + len(t)] for one in made)
            return speed, acceleration, distance
        # Values far from these times have no say, and would be looked through.
        near = slice(max(first - 1, 0), int(np.searchsorted(self.t, t[-1], side="right")) + 1)
        speed, acceleration, distance = (np.interp(t, self.t[near], one[near]) for one in made)
        return speed, acceleration, distance

    def apply(self, body: Body) -> Body:
        """The body with the speed corrected, and all that follows from it."""
        speed, acceleration, distance = self.at(body.t)
        return replace(
            body,
            speed=body.speed + speed,
            acceleration=body.acceleration + acceleration,
            distance=body.distance + distance,
        )
