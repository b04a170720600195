"""Inputs of the forward model as functions of time: speed, yaw rate, temperature and supply."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS, REFERENCE_VOLTS
from hubodo.smoothing_spline import SmoothingSpline


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """Motion of the body origin and environment of the nodes at N times, (N,) each.

    Attributes
    ----------
    t : s since the start of the log.
    speed, acceleration, jerk, distance : m/s, m/s², m/s³, and m from the start of the log.
    yaw_rate, yaw_acceleration, yaw_jerk, heading : rad/s, rad/s², rad/s³, and rad from the start of the log.
    temperature, supply : °C and V.
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

    def select(self, samples: slice) -> BodyMotion:
        """Return the motion at a slice of the times."""
        return BodyMotion(*(getattr(self, it.name)[samples] for it in fields(self)))


@dataclass(frozen=True, slots=True)
class EarthRotation:
    """Rotation of the Earth under a bench.

    latitude: rad. azimuth: rad, of the x axis of the body at heading 0, clockwise from north.
    """

    latitude: float
    azimuth: float = 0.0

    def rate_and_derivative(self, heading: Array, yaw_rate: Array) -> tuple[Array, Array]:
        """Return the angular rate of the Earth in body axes and its derivative, (3, N) each."""
        horizontal, vertical = EARTH_RATE * np.cos(self.latitude), EARTH_RATE * np.sin(self.latitude)
        azimuth = self.azimuth - heading
        zero = np.zeros_like(heading)
        rate = np.stack([horizontal * np.cos(azimuth), horizontal * np.sin(azimuth), zero + vertical])
        return rate, np.stack([yaw_rate * rate[1], -yaw_rate * rate[0], zero])


@dataclass(frozen=True, slots=True)
class Trace:
    """A slowly varying record: values at times t, in s since the start of the log, (M,) each."""

    t: Array
    values: Array

    def at(self, t: Array) -> Array:
        """Return the values interpolated at t, (N,); the first and last value are held outside the record."""
        if len(self.t) == 1:
            return np.broadcast_to(self.values, t.shape)
        return np.interp(t, self.t, self.values)

    @staticmethod
    def constant(value: float) -> Trace:
        """Return a record with one value at all times."""
        return Trace(np.zeros(1), np.full(1, value))


_REFERENCE_TEMPERATURE = Trace.constant(REFERENCE_CELSIUS)
_REFERENCE_SUPPLY = Trace.constant(REFERENCE_VOLTS)


@dataclass(frozen=True)
class MotionInputs:
    """Inputs of the forward model.

    Attributes
    ----------
    speed, yaw_rate : m/s and rad/s of the body origin.
    temperature, supply : °C and V, of the nodes.
    earth : rotation of the Earth; only for nodes on the body, in experiments that can resolve it.
    """

    speed: SmoothingSpline
    yaw_rate: SmoothingSpline
    temperature: Trace = _REFERENCE_TEMPERATURE
    supply: Trace = _REFERENCE_SUPPLY
    earth: EarthRotation | None = None

    def at(self, t: Array) -> BodyMotion:
        """Return motion and environment at times t, (N,) s since the start of the log."""
        environment = self.temperature.at(t), self.supply.at(t)
        return BodyMotion(t, *self.speed.evaluate(t), *self.yaw_rate.evaluate(t), *environment)


class MotionCorrection(Protocol):
    """A correction of the motion given by the inputs."""

    def apply(self, body: BodyMotion) -> BodyMotion:
        """Return the corrected motion."""


@dataclass(frozen=True, slots=True)
class DelayedMotion:
    """A delay of the time stamps, in s, small enough for a first-order expansion of the motion.

    inner: correction that is applied first.
    """

    delay: float
    inner: MotionCorrection | None = None

    def apply(self, body: BodyMotion) -> BodyMotion:
        """Return the motion `delay` earlier."""
        if self.inner is not None:
            body = self.inner.apply(body)
        return replace(
            body,
            speed=body.speed - self.delay * body.acceleration,
            acceleration=body.acceleration - self.delay * body.jerk,
            distance=body.distance - self.delay * body.speed,
            yaw_rate=body.yaw_rate - self.delay * body.yaw_acceleration,
            yaw_acceleration=body.yaw_acceleration - self.delay * body.yaw_jerk,
            heading=body.heading - self.delay * body.yaw_rate,
        )


@dataclass(frozen=True, slots=True)
class ExtraSpeed:
    """A constant increase of speed, in m/s, and of acceleration, in m/s².

    inner: correction that is applied first.
    """

    speed: float = 0.0
    acceleration: float = 0.0
    inner: MotionCorrection | None = None

    def apply(self, body: BodyMotion) -> BodyMotion:
        """Return the motion with speed and acceleration increased; the distance is unchanged."""
        if self.inner is not None:
            body = self.inner.apply(body)
        return replace(
            body, speed=body.speed + self.speed, acceleration=body.acceleration + self.acceleration
        )


@dataclass(frozen=True)
class SpeedCorrection:
    """A correction of a measured speed input: `speed` in m/s to be added at times t in s, (M,) each."""

    t: Array
    speed: Array

    @cached_property
    def acceleration(self) -> Array:
        """Return the derivative of the speed correction, (M,) m/s²."""
        return np.asarray(np.gradient(self.speed, self.t))

    @cached_property
    def distance(self) -> Array:
        """Return the integral of the speed correction, (M,) m."""
        step = np.diff(self.t)
        return np.concatenate([[0.0], np.cumsum(0.5 * step * (self.speed[1:] + self.speed[:-1]))])

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return speed, acceleration and distance of the correction at times t, (N,) each."""
        columns = self.speed, self.acceleration, self.distance
        first = int(np.searchsorted(self.t, t[0]))
        if np.array_equal(t, self.t[first : first + len(t)]):
            speed, acceleration, distance = (it[first : first + len(t)] for it in columns)
            return speed, acceleration, distance
        # Only the neighbourhood of t is passed on: np.interp would search all of a long correction.
        near = slice(max(first - 1, 0), int(np.searchsorted(self.t, t[-1], side="right")) + 1)
        speed, acceleration, distance = (np.interp(t, self.t[near], it[near]) for it in columns)
        return speed, acceleration, distance

    def apply(self, body: BodyMotion) -> BodyMotion:
        """Return the motion with corrected speed, acceleration and distance."""
        speed, acceleration, distance = self.at(body.t)
        return replace(
            body,
            speed=body.speed + speed,
            acceleration=body.acceleration + acceleration,
            distance=body.distance + distance,
        )
