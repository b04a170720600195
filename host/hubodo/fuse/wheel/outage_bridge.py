"""Motion during an outage of seconds, from the wheel angles before and after it.

The contact of wheel i rolled

    s_i = R_i (1 + e_i) (θ_i' - θ_i + 2 π n_i) = s - y_i ψ

with radius R, its error e, angles θ before and θ' after the outage, an unknown number of turns n, path s and
change of heading ψ of the vehicle, and lateral position y of the contact. In between, speed and yaw rate are
the Ornstein-Uhlenbeck processes of `free_motion.py` given both of their ends, and finally their integrals s
and ψ (Gaussian process regression). The numbers of turns with the most likely s and ψ are used; the others
add the squares of their distance to the covariance, by their probability.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import (
    HEADING,
    SPEED,
    TRACK_WIDTH,
    WHEEL_ANGLE,
    WHEEL_RADIUS,
    YAW_RATE,
    Entry,
    X,
    Y,
)
from hubodo.fuse.wheel.free_motion import MotionSigmas, RateProcess, speed_process, yaw_rate_process
from hubodo.fuse.wheel.wheel import Wheel

MAX_BRIDGED_OUTAGE_S = 6.0
"""s; in a longer outage too many numbers of turns are equally likely. Estimated."""

_MAX_TURNS = 4
"""Turns on either side of the expected number that are compared."""

_END_RATE_SIGMA = 0.02
"""m/s and rad/s, 1 sigma of the motion in the first window after an outage. Estimated."""

_N_STEPS = 32
"""Steps into which an outage is divided."""

_POSE = (X, Y, HEADING)


class OutageEnd(NamedTuple):
    """Wheels and vehicle at the end of an outage, estimated from the windows after it.

    Attributes
    ----------
    angles : rad, of each wheel; their 1 sigma is the prior of `WHEEL_ANGLE`.
    speed, yaw_rate : m/s and rad/s.
    """

    angles: tuple[float, ...]
    speed: float
    yaw_rate: float


class BridgedState(NamedTuple):
    """States after an outage.

    Attributes
    ----------
    x : states.
    transition : (n, n), their derivatives by the states before.
    noise : (n, n), covariance that the outage adds.
    probability : probability of the numbers of turns that were chosen.
    """

    x: list[float]
    transition: Array
    noise: Array
    probability: float


class _Rate(NamedTuple):
    """A rate at K times during an outage, given its values at the first and the last of them.

    Attributes
    ----------
    shape : (K,), mean given a value of 1 at the start and no value at the end.
    covariance : (K, K), for a known start.
    weights : (K,) s, of the integral over time.
    start, end : the known ends.
    """

    shape: Array
    covariance: Array
    weights: Array
    start: float
    end: float

    @staticmethod
    def of(process: RateProcess, seconds: float, start: float, end: float) -> _Rate:
        """Return the rate of a process during `seconds`."""
        t = np.linspace(0.0, seconds, _N_STEPS + 1)
        weights = np.full(len(t), seconds / _N_STEPS)
        weights[[0, -1]] *= 0.5
        return _Rate(np.exp(-t / process.time), process.covariance(t), weights, start, end)

    def expected_integral(self) -> tuple[float, float, Array]:
        """Return mean and variance of the integral, and its derivatives by start and end, (2,)."""
        with_end = float(self.weights @ self.covariance[:, -1])
        by_end = with_end / self.covariance[-1, -1]
        by_start = float(self.weights @ self.shape) - by_end * self.shape[-1]
        variance = float(self.weights @ self.covariance @ self.weights) - by_end * with_end
        return by_start * self.start + by_end * self.end, variance, np.array([by_start, by_end])

    def given_integral(self, integral: float) -> tuple[Array, Array, Array]:
        """Return the rate (K,), its derivatives by start, end and integral (K, 3), and covariance (K, K)."""
        known = np.array([np.eye(len(self.weights))[-1], self.weights])
        product_ = known @ self.covariance
        gain = np.linalg.solve(product_ @ known.T, product_).T
        by = np.column_stack([self.shape - gain @ (known @ self.shape), gain])
        return by @ [self.start, self.end, integral], by, self.covariance - gain @ product_


class _Path(NamedTuple):
    """Path s, m, and change of heading ψ, rad, of the vehicle, and their derivatives by the inputs."""

    values: Array
    by: Array


class OutageBridge:
    """One outage: the states x (n,) before it, and estimates of wheels and vehicle at its end.

    The inputs of all derivatives are the n states before, then speed, yaw rate and wheel angles after, then
    one noise for each wheel and, for a single wheel, one for the change of heading.
    """

    def __init__(
        self,
        x: Sequence[float],
        columns: Mapping[Entry, int],
        wheels: Sequence[Wheel],
        seconds: float,
        motion_sigmas: MotionSigmas,
        end: OutageEnd,
    ) -> None:
        self._x, self._at, self._wheels, self._end = np.array(x), columns, wheels, end
        self._speed_end, self._yaw_end = len(x), len(x) + 1
        self._angles_end = len(x) + 2
        self._noises = self._angles_end + len(wheels)
        self._n_inputs = self._noises + len(wheels) + (len(wheels) == 1)
        self._speed = _Rate.of(speed_process(motion_sigmas), seconds, x[columns[SPEED]], end.speed)
        self._yaw = _Rate.of(yaw_rate_process(motion_sigmas), seconds, x[columns[YAW_RATE]], end.yaw_rate)

    def solve(self, roughness: float, lateral_slip: float) -> BridgedState:
        """Return the states after the outage; roughness, lateral_slip: m/√m, along and across the path."""
        candidates = self._candidates()
        costs = np.array([cost for cost, _ in candidates])
        probabilities = np.exp(-0.5 * (costs - costs.min()))
        probabilities /= probabilities.sum()
        best = candidates[int(np.argmin(costs))][1]
        pose, by, noise = self._pose(best)
        length = float(abs(best.values[0])) + 0.1
        course = self._x[self._at[HEADING]] + 0.5 * best.values[1]
        across = np.array([-math.sin(course), math.cos(course), 0.0])
        noise += lateral_slip**2 * length * np.outer(across, across)
        for (_, other), probability in zip(candidates, probabilities, strict=True):
            if other is not best and probability > 1e-4:
                distance = self._pose(other)[0] - pose
                noise += probability * np.outer(distance, distance)
        return self._assemble(pose, by, noise, roughness**2 * length, float(probabilities.max()))

    def _candidates(self) -> list[tuple[float, _Path]]:
        """Return paths for all numbers of turns near the expected ones, with -2 log of their likelihood."""
        length, length_variance, _ = self._speed.expected_integral()
        turn, turn_variance, _ = self._yaw.expected_integral()
        offsets = []
        for index, wheel in enumerate(self._wheels):
            at, circumference = wheel.columns, 2.0 * math.pi * self._radius(wheel)
            angle = self._end.angles[index] - self._x[at[WHEEL_ANGLE]]
            expected = length - turn * self._contact(wheel)
            nearest = round((expected - self._radius(wheel) * angle) / circumference)
            offsets.append(
                [angle + 2.0 * math.pi * (nearest + n) for n in range(-_MAX_TURNS, _MAX_TURNS + 1)]
            )
        result = []
        for angles in product(*offsets):
            path = self._path(angles)
            error = path.values - [length, turn]
            result.append((error[0] ** 2 / length_variance + error[1] ** 2 / turn_variance, path))
        return result

    def _radius(self, wheel: Wheel) -> float:
        return wheel.geometry.radius * (1.0 + float(self._x[wheel.columns[WHEEL_RADIUS]]))

    def _contact(self, wheel: Wheel) -> float:
        return wheel.geometry.contact_y * (1.0 + float(self._x[wheel.columns[TRACK_WIDTH]]))

    def _path(self, angles: Sequence[float]) -> _Path:
        """Return path and change of heading for the angles by which the wheels turned, rad."""
        rolled = np.array([self._radius(w) * angle for w, angle in zip(self._wheels, angles, strict=True)])
        by = np.zeros((len(angles), self._n_inputs))
        for index, (wheel, angle) in enumerate(zip(self._wheels, angles, strict=True)):
            at, radius = wheel.columns, self._radius(wheel)
            by[index, at[WHEEL_ANGLE]], by[index, self._angles_end + index] = -radius, radius
            by[index, at[WHEEL_RADIUS]] = wheel.geometry.radius * angle
            by[index, self._noises + index] = 1.0
        contacts = [self._contact(wheel) for wheel in self._wheels]
        if len(rolled) == 1:
            turn, _, (by_start, by_end) = self._yaw.expected_integral()
            by_turn = np.zeros(self._n_inputs)
            by_turn[self._at[YAW_RATE]], by_turn[self._yaw_end], by_turn[-1] = by_start, by_end, 1.0
        else:
            base = contacts[0] - contacts[1]
            turn, by_turn = (rolled[1] - rolled[0]) / base, (by[1] - by[0]) / base
            by_turn[self._at[TRACK_WIDTH]] -= turn / (1.0 + self._x[self._at[TRACK_WIDTH]])
        by_length = by[0] + contacts[0] * by_turn
        by_length[self._at[TRACK_WIDTH]] += turn * self._wheels[0].geometry.contact_y
        return _Path(np.array([rolled[0] + contacts[0] * turn, turn]), np.array([by_length, by_turn]))

    def _pose(self, path: _Path) -> tuple[Array, Array, Array]:
        """Return x, y and heading after the outage, their derivatives by the inputs, and noise (3, 3)."""
        speed, speed_by, speed_covariance = self._speed.given_integral(path.values[0])
        yaw, yaw_by, yaw_covariance = self._yaw.given_integral(path.values[1])
        # Heading at each time by the trapezoidal rule.
        step = 2.0 * self._speed.weights[0]
        integrate = step * (np.tri(len(yaw)) - 0.5 * np.eye(len(yaw)))
        integrate[:, 0] -= 0.5 * step
        integrate[0] = 0.0
        heading = self._x[self._at[HEADING]]
        direction = np.exp(1j * (heading + integrate @ yaw)) * self._speed.weights
        by_speed, by_yaw = direction, (1j * direction * speed) @ integrate
        displacement = complex(direction @ speed)
        by = np.zeros((3, self._n_inputs))
        for column, value in (
            (self._at[HEADING], 1j * displacement),
            (self._at[SPEED], by_speed @ speed_by[:, 0]),
            (self._speed_end, by_speed @ speed_by[:, 1]),
            (self._at[YAW_RATE], by_yaw @ yaw_by[:, 0]),
            (self._yaw_end, by_yaw @ yaw_by[:, 1]),
        ):
            by[:2, column] += value.real, value.imag
        for value, row in zip((by_speed @ speed_by[:, 2], by_yaw @ yaw_by[:, 2]), path.by, strict=True):
            by[0] += value.real * row
            by[1] += value.imag * row
        by[2] = path.by[1]
        for row, entry in enumerate(_POSE):
            by[row, self._at[entry]] += 1.0
        noise = np.zeros((3, 3))
        for derivative, covariance in ((by_speed, speed_covariance), (by_yaw, yaw_covariance)):
            parts = np.array([derivative.real, derivative.imag])
            noise[:2, :2] += parts @ covariance @ parts.T
        change = np.array([displacement.real, displacement.imag, path.values[1]])
        return self._x[[self._at[entry] for entry in _POSE]] + change, by, noise

    def _assemble(
        self, pose: Array, by: Array, noise: Array, rolling_variance: float, probability: float
    ) -> BridgedState:
        """Return all states: the pose, and speed, yaw rate and wheel angles as after the outage."""
        n = len(self._x)
        x, rows = self._x.copy(), np.eye(n, self._n_inputs)
        at = [self._at[entry] for entry in _POSE]
        x[at], rows[at] = pose, by
        resets = [(self._at[SPEED], self._speed_end, self._end.speed)]
        resets.append((self._at[YAW_RATE], self._yaw_end, self._end.yaw_rate))
        for index, wheel in enumerate(self._wheels):
            angle = math.remainder(self._end.angles[index], 2.0 * math.pi)
            resets.append((wheel.columns[WHEEL_ANGLE], self._angles_end + index, angle))
        for column, source, value in resets:
            x[column], rows[column] = value, 0.0
            rows[column, source] = 1.0
        variances = np.full(self._n_inputs - n, rolling_variance)
        variances[:2] = _END_RATE_SIGMA**2
        variances[2 : 2 + len(self._wheels)] = WHEEL_ANGLE.prior**2
        if len(self._wheels) == 1:
            variances[-1] = self._yaw.expected_integral()[1]
        inputs = rows[:, n:]
        added = (inputs * variances) @ inputs.T
        added[np.ix_(at, at)] += noise
        return BridgedState(x.tolist(), rows[:, :n], added, probability)
