"""Physics of the independent simulator: a rigid wheel at 1 kHz, differentiated numerically.

All vectors are in world axes. The wheel angle is the integral of the rolling rate (fourth-order quadrature;
for an eccentric wheel, Newton's method on the arc length). The rate follows from the derivatives of the three
node axes, the specific force from the second derivative of the position of the sensing point plus gravity.
The world axes lie in the road plane: on a grade, the vertical is tilted in them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

GRAVITY = 9.80665
STEP = 1e-3
Array = np.ndarray


@dataclass(frozen=True)
class Motion:
    """Motion of the vehicle.

    speed, yaw_rate: (N,) m/s and rad/s of the body origin every `step` s from t = 0; their first derivatives
        must be continuous
    """

    speed: Array
    yaw_rate: Array
    step: float = STEP

    @cached_property
    def t(self) -> Array:
        """Return the times (N,), s."""
        return np.arange(len(self.speed)) * self.step

    @cached_property
    def axes(self) -> tuple[Array, Array, Array]:
        """Return the forward, left and up axes of the body in world axes, each (3, N)."""
        heading = integrate(self.yaw_rate, self.step)
        cosine, sine, zero = np.cos(heading), np.sin(heading), np.zeros(len(heading))
        return (
            np.stack([cosine, sine, zero]),
            np.stack([-sine, cosine, zero]),
            np.stack([zero, zero, zero + 1.0]),
        )

    @cached_property
    def acceleration(self) -> Array:
        """Return the acceleration of the body origin in world axes, (3, N) m/s²."""
        return differentiate(self.speed * self.axes[0], self.step)


@dataclass(frozen=True)
class Wheel:
    """The true parameters of one wheel and of the node on it.

    side: +1 left, -1 right
    facing: +1 if the z axis of the node points left, -1 right
    radius, track: m
    start_angle: rad
    growth: relative growth of the radius per squared spin rate, s²/rad²
    slip: relative slip per acceleration, s²/m
    eccentricity: relative amplitude of the rolling radius, at the angle `phase`, rad
    camber, grade: rad
    arm: (3,) m from the axle to the sensing point, in node axes
    """

    side: float
    facing: float
    radius: float
    track: float
    start_angle: float = 0.0
    growth: float = 0.0
    slip: float = 0.0
    eccentricity: float = 0.0
    phase: float = 0.0
    camber: float = 0.0
    grade: float = 0.0
    arm: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class IdealReadings:
    """Ideal readings of a node at the times of the motion.

    angle: (N,) wheel angle, rad
    rate: (3, N) angular rate, rad/s
    force: (3, N) specific force, m/s²
    """

    motion: Motion = field(repr=False)
    angle: Array
    rate: Array
    force: Array


def compute_ideal_readings(motion: Motion, wheel: Wheel) -> IdealReadings:
    """Return angular rate and specific force at the sensing point, in node axes before misalignment."""
    forward, left, up = motion.axes
    lean_angle = wheel.side * wheel.camber
    wheel_up = np.cos(lean_angle) * up - np.sin(lean_angle) * left
    axle = np.cos(lean_angle) * left + np.sin(lean_angle) * up
    angle = wheel_angle(motion, wheel)
    cosine, sine = np.cos(angle), np.sin(angle)
    x = cosine * wheel_up + sine * forward
    y = wheel.facing * (cosine * forward - sine * wheel_up)
    z = wheel.facing * axle
    rate = np.stack(
        [
            dot(differentiate(y, motion.step), z),
            dot(differentiate(z, motion.step), x),
            dot(differentiate(x, motion.step), y),
        ]
    )
    hub_offset = wheel.side * (0.5 * wheel.track - wheel.radius * np.sin(wheel.camber))
    sensing_point = hub_offset * left + wheel.arm[0] * x + wheel.arm[1] * y + wheel.arm[2] * z
    vertical = np.cos(wheel.grade) * up + np.sin(wheel.grade) * forward
    specific_force = (
        motion.acceleration + differentiate_twice(sensing_point, motion.step) + GRAVITY * vertical
    )
    return IdealReadings(motion, angle, rate, np.stack([dot(specific_force, axis) for axis in (x, y, z)]))


def contact_speed(motion: Motion, wheel: Wheel) -> Array:
    """Return the speed of the wheel's contact point over the ground, (N,) m/s."""
    return motion.speed - motion.yaw_rate * wheel.side * 0.5 * wheel.track


def wheel_angle(motion: Motion, wheel: Wheel) -> Array:
    """Return the wheel angle, (N,) rad.

    The spin rate w solves w (1 + growth w²) (1 + eccentricity cos(angle - phase)) = rolling speed / radius.
    """
    rolling_rate = contact_speed(motion, wheel)
    rolling_rate = rolling_rate * (1.0 + wheel.slip * differentiate(rolling_rate, motion.step)) / wheel.radius
    start_angle, eccentricity = wheel.start_angle, wheel.eccentricity
    arc_start = start_angle + eccentricity * np.sin(start_angle - wheel.phase)
    radius_growth: Array | float = 1.0
    angle = np.zeros(len(rolling_rate))
    for _ in range(8 if wheel.growth and eccentricity else 2 if wheel.growth else 1):
        arc = arc_start + integrate(rolling_rate / radius_growth, motion.step)
        angle = arc
        for _ in range(6 if eccentricity else 0):
            residual = angle + eccentricity * np.sin(angle - wheel.phase) - arc
            angle = angle - residual / (1.0 + eccentricity * np.cos(angle - wheel.phase))
        if wheel.growth:
            radius_growth = 1.0 + wheel.growth * _solve_spin_rate(rolling_rate, angle, wheel) ** 2
    return angle


def _solve_spin_rate(rolling_rate: Array, angle: Array, wheel: Wheel) -> Array:
    """Return the spin rate of a wheel that grows with it, rad/s, by Newton's method."""
    rate_without_growth = rolling_rate / (1.0 + wheel.eccentricity * np.cos(angle - wheel.phase))
    rate = rate_without_growth
    for _ in range(6):
        rate = rate - (rate + wheel.growth * rate**3 - rate_without_growth) / (
            1.0 + 3.0 * wheel.growth * rate**2
        )
    return rate


def dot(a: Array, b: Array) -> Array:
    """Return the scalar products, (N,), of two series of vectors, (3, N)."""
    return np.einsum("in,in->n", a, b)


def integrate(value: Array, step: float) -> Array:
    """Return the integral, (N,), from the first sample, by cubic interpolation of four samples.

    The first and last intervals use the trapezoidal rule.
    """
    intervals = 0.5 * (value[1:] + value[:-1])
    intervals[1:-1] += (value[1:-2] + value[2:-1] - value[:-3] - value[3:]) / 24.0
    return step * np.concatenate([[0.0], np.cumsum(intervals)])


def differentiate(value: Array, step: float) -> Array:
    """Return the fourth-order first derivative along the last axis; two samples at each end are repeated."""
    derivative = np.empty_like(value)
    derivative[..., 2:-2] = 8.0 * (value[..., 3:-1] - value[..., 1:-3]) - (value[..., 4:] - value[..., :-4])
    derivative[..., 2:-2] /= 12.0 * step
    return _edges(derivative)


def differentiate_twice(value: Array, step: float) -> Array:
    """Return the fourth-order second derivative along the last axis; two samples at each end are repeated."""
    derivative = np.empty_like(value)
    derivative[..., 2:-2] = 16.0 * (value[..., 3:-1] + value[..., 1:-3]) - (value[..., 4:] + value[..., :-4])
    derivative[..., 2:-2] -= 30.0 * value[..., 2:-2]
    derivative[..., 2:-2] /= 12.0 * step**2
    return _edges(derivative)


def _edges(derivative: Array) -> Array:
    """Return the derivative with two repeated samples at each end."""
    derivative[..., :2] = derivative[..., 2:3]
    derivative[..., -2:] = derivative[..., -3:-2]
    return derivative
