"""Physics of the independent simulator: a rigid wheel at 1 kHz, differentiated numerically.

Nothing is written in node axes. The wheel angle comes from the rolled arc (fourth-order quadrature, an
eccentric wheel by Newton's method on its arc length), the node's axes are three vectors in the world, its
rate is how these turn into each other, and the specific force is the second difference of where the sensing
point is, plus gravity. World axes lie in the road: on a grade it is the vertical that leans in them.
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

    speed, yaw_rate: (N,) m/s, rad/s of the body origin every `step` s from t = 0, with continuous first
        derivatives.
    """

    speed: Array
    yaw_rate: Array
    step: float = STEP

    @cached_property
    def t(self) -> Array:
        return np.arange(len(self.speed)) * self.step

    @cached_property
    def axes(self) -> tuple[Array, Array, Array]:
        """Forward, left, up of the body in the world, each (3, N)."""
        heading = integral(self.yaw_rate, self.step)
        c, s, zero = np.cos(heading), np.sin(heading), np.zeros(len(heading))
        return np.stack([c, s, zero]), np.stack([-s, c, zero]), np.stack([zero, zero, zero + 1.0])

    @cached_property
    def acceleration(self) -> Array:
        """Of the body origin in the world, (3, N)."""
        return slope(self.speed * self.axes[0], self.step)


@dataclass(frozen=True)
class Wheel:
    """One wheel and the node on it, as they truly are.

    side: +1 left, -1 right. facing: +1 when the node's z axis points left, -1 right. radius, track: m.
        growth: s²/rad². slip: s²/m. eccentricity: amplitude of the radius as a fraction, at angle `phase`.
        camber, grade, start_angle: rad. arm: (3,) m from the axle to the sensing point, node axes.
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
class Channels:
    """Ideal readings: angle, (N,) rad, rate, (3, N) rad/s, force, (3, N) m/s², along Motion.t."""

    motion: Motion = field(repr=False)
    angle: Array
    rate: Array
    force: Array


def feel(motion: Motion, wheel: Wheel) -> Channels:
    """Return rate and specific force at the sensing point, in node axes before the mounting error."""
    forward, left, up = motion.axes
    lean = wheel.side * wheel.camber
    wheel_up = np.cos(lean) * up - np.sin(lean) * left
    axle = np.cos(lean) * left + np.sin(lean) * up
    angle = wheel_angle(motion, wheel)
    c, s = np.cos(angle), np.sin(angle)
    x = c * wheel_up + s * forward
    y = wheel.facing * (c * forward - s * wheel_up)
    z = wheel.facing * axle
    rate = np.stack(
        [dot(slope(y, motion.step), z), dot(slope(z, motion.step), x), dot(slope(x, motion.step), y)]
    )
    hub = wheel.side * (0.5 * wheel.track - wheel.radius * np.sin(wheel.camber))
    place = hub * left + wheel.arm[0] * x + wheel.arm[1] * y + wheel.arm[2] * z
    vertical = np.cos(wheel.grade) * up + np.sin(wheel.grade) * forward
    pull = motion.acceleration + curvature(place, motion.step) + GRAVITY * vertical
    return Channels(motion, angle, rate, np.stack([dot(pull, axis) for axis in (x, y, z)]))


def contact_speed(motion: Motion, wheel: Wheel) -> Array:
    """Return the speed of the wheel's contact point over the ground, (N,) m/s."""
    return motion.speed - motion.yaw_rate * wheel.side * 0.5 * wheel.track


def wheel_angle(motion: Motion, wheel: Wheel) -> Array:
    """Return the wheel angle, (N,) rad.

    Solves w (1 + growth w²) (1 + eccentricity cos(angle - phase)) = rolled speed / radius.
    """
    rolled = contact_speed(motion, wheel)
    rolled = rolled * (1.0 + wheel.slip * slope(rolled, motion.step)) / wheel.radius
    start, swing = wheel.start_angle, wheel.eccentricity
    arc_start = start + swing * np.sin(start - wheel.phase)
    stretch: Array | float = 1.0
    angle = np.zeros(len(rolled))
    for _ in range(8 if wheel.growth and swing else 2 if wheel.growth else 1):
        arc = arc_start + integral(rolled / stretch, motion.step)
        angle = arc
        for _ in range(6 if swing else 0):
            miss = angle + swing * np.sin(angle - wheel.phase) - arc
            angle = angle - miss / (1.0 + swing * np.cos(angle - wheel.phase))
        if wheel.growth:
            stretch = 1.0 + wheel.growth * _grown_rate(rolled, angle, wheel) ** 2
    return angle


def _grown_rate(rolled: Array, angle: Array, wheel: Wheel) -> Array:
    wanted = rolled / (1.0 + wheel.eccentricity * np.cos(angle - wheel.phase))
    rate = wanted
    for _ in range(6):
        rate = rate - (rate + wheel.growth * rate**3 - wanted) / (1.0 + 3.0 * wheel.growth * rate**2)
    return rate


def dot(a: Array, b: Array) -> Array:
    """Return the products, (N,), of two fields of vectors, (3, N)."""
    return np.einsum("in,in->n", a, b)


def integral(value: Array, step: float) -> Array:
    """Return the integral, (N,), from the first sample by the cubic through four samples.

    The ends use a trapezoid.
    """
    piece = 0.5 * (value[1:] + value[:-1])
    piece[1:-1] += (value[1:-2] + value[2:-1] - value[:-3] - value[3:]) / 24.0
    return step * np.concatenate([[0.0], np.cumsum(piece)])


def slope(value: Array, step: float) -> Array:
    """Return the first derivative along the last axis, fourth order; two samples at each end repeat."""
    made = np.empty_like(value)
    made[..., 2:-2] = 8.0 * (value[..., 3:-1] - value[..., 1:-3]) - (value[..., 4:] - value[..., :-4])
    made[..., 2:-2] /= 12.0 * step
    return _edges(made)


def curvature(value: Array, step: float) -> Array:
    """Return the second derivative along the last axis, fourth order; ends as in `slope`."""
    made = np.empty_like(value)
    made[..., 2:-2] = 16.0 * (value[..., 3:-1] + value[..., 1:-3]) - (value[..., 4:] + value[..., :-4])
    made[..., 2:-2] -= 30.0 * value[..., 2:-2]
    made[..., 2:-2] /= 12.0 * step**2
    return _edges(made)


def _edges(made: Array) -> Array:
    made[..., :2] = made[..., 2:3]
    made[..., -2:] = made[..., -3:-2]
    return made
