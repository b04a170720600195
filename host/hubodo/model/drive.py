"""Drives: smooth speed and yaw rate of a vehicle over time, with the path they make."""

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from hubodo.model.frames import Array
from hubodo.model.kinematics import BodyMotion, WheelMount

_STEP = 0.01


@dataclass(frozen=True)
class Leg:
    """One stretch of a scripted drive: s, m/s, rad/s."""

    duration: float
    speed: float
    yaw_rate: float = 0.0


@dataclass(frozen=True)
class Drive:
    """Speed and yaw rate of the body origin as functions of time that have smooth derivatives.

    t: (N,) s, increasing from 0. speed: (N,) m/s. yaw_rate: (N,) rad/s.
    """

    t: Array
    speed: Array
    yaw_rate: Array
    _speed: CubicSpline = field(init=False, repr=False, compare=False)
    _yaw_rate: CubicSpline = field(init=False, repr=False, compare=False)
    _distance: CubicSpline = field(init=False, repr=False, compare=False)
    _heading: CubicSpline = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        speed, yaw_rate = CubicSpline(self.t, self.speed), CubicSpline(self.t, self.yaw_rate)
        for name, value in (
            ("_speed", speed),
            ("_yaw_rate", yaw_rate),
            ("_distance", speed.antiderivative()),
            ("_heading", yaw_rate.antiderivative()),
        ):
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        return float(self.t[-1])

    def body(self, t: Array) -> BodyMotion:
        """Motion of the body origin at times t, (N,) s; at rest before the start and after the end."""
        inside = np.clip(t, self.t[0], self.t[-1])
        moving = inside == t
        return BodyMotion(
            self._speed(inside),
            np.where(moving, self._speed(inside, 1), 0.0),
            self._yaw_rate(inside),
            np.where(moving, self._yaw_rate(inside, 1), 0.0),
        )

    def heading(self, t: Array) -> Array:
        """Heading (N,) rad at times t, anticlockwise from where the drive began."""
        return np.asarray(self._heading(np.clip(t, self.t[0], self.t[-1])))

    def wheel_angle(self, t: Array, mount: WheelMount, start: float = 0.0) -> Array:
        """Wheel angle (N,) rad at times t, in closed form, so that it does not drift from the speeds."""
        inside = np.clip(t, self.t[0], self.t[-1])
        rolled = self._distance(inside) - mount.contact_y * self._heading(inside)
        return np.asarray(start + rolled / mount.radius)

    def path(self, heading: float = 0.0) -> tuple[Array, Array, Array, Array]:
        """t, x, y (m, from the start) and heading (rad, anticlockwise from x) on a 10 ms grid."""
        t = np.arange(self.t[0], self.t[-1] + 0.5 * _STEP, _STEP)
        middle = t[:-1] + 0.5 * _STEP
        # Simpson's rule on each step: the error is far below a micrometre for a vehicle's motion.
        at = np.sort(np.concatenate([t, middle]))
        course = heading + self._heading(np.minimum(at, self.t[-1]))
        speed = self._speed(np.minimum(at, self.t[-1]))
        vx, vy = speed * np.cos(course), speed * np.sin(course)
        x = np.concatenate([[0.0], np.cumsum(_simpson(vx))])
        y = np.concatenate([[0.0], np.cumsum(_simpson(vy))])
        return t, x, y, course[::2]


def _simpson(value: Array) -> Array:
    return np.asarray(_STEP / 6.0 * (value[:-2:2] + 4.0 * value[1:-1:2] + value[2::2]))


def scripted(legs: list[Leg], smoothing: float = 0.4) -> Drive:
    """A drive through legs of constant speed and yaw rate, rounded by a Gaussian of `smoothing` seconds.

    Raises ValueError for an empty list or a leg without duration.
    """
    if not legs or any(leg.duration <= 0 for leg in legs):
        raise ValueError("a drive needs at least one leg, each of positive duration")
    ends = np.cumsum([leg.duration for leg in legs])
    t = np.arange(0.0, ends[-1] + 0.5 * _STEP, _STEP)
    leg = np.minimum(np.searchsorted(ends, t, side="right"), len(legs) - 1)
    width = smoothing / _STEP
    speed = gaussian_filter1d(np.array([item.speed for item in legs])[leg], width, mode="nearest")
    yaw_rate = gaussian_filter1d(np.array([item.yaw_rate for item in legs])[leg], width, mode="nearest")
    return Drive(t, speed, yaw_rate)


def loop_drive(rng: np.random.Generator, rest: float = 8.0, moving: float = 60.0) -> Drive:
    """A drive that begins and ends at rest and comes round about once, with random legs in between."""
    legs = [Leg(rest, 0.0)]
    left = moving
    turn = 2.0 * np.pi / moving
    while left > 0.0:
        duration = min(left, float(rng.uniform(4.0, 8.0)))
        yaw_rate = turn + float(rng.uniform(-0.1, 0.1))
        legs.append(Leg(duration, float(rng.uniform(0.8, 1.8)), yaw_rate))
        left -= duration
    legs.append(Leg(4.0, 0.0))
    return scripted(legs)
