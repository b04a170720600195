"""Drives: smooth speed and yaw rate of a vehicle over time, and the path that they make."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hubodo.arrays import Array
from hubodo.model.inputs import Inputs
from hubodo.smoothing_spline import fit_interpolating_spline

_STEP = 0.01
_ROUNDED = 0.4


@dataclass(frozen=True)
class Leg:
    """One stretch of a scripted drive: s, m/s, rad/s."""

    duration: float
    speed: float
    yaw_rate: float = 0.0


def scripted(legs: list[Leg], smoothing: float = _ROUNDED) -> Inputs:
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
    return Inputs(fit_interpolating_spline(t, speed), fit_interpolating_spline(t, yaw_rate))


def loop_drive(rng: np.random.Generator, rest: float = 8.0, moving: float = 60.0) -> Inputs:
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


def random_drive(rng: np.random.Generator, duration: float, fastest: float = 2.5) -> Inputs:
    """Random legs, both ways round, now and then a rest or a turn on the spot; begins and ends at rest.

    duration: s. fastest: m/s.
    """
    # Four widths of the rounding: then it does rest.
    legs = [Leg(min(max(0.05 * duration, 4.0 * _ROUNDED), 0.3 * duration), 0.0)]
    left = duration - 2.0 * legs[0].duration
    while left > 0.0:
        length = min(left, float(rng.uniform(1.5, 6.0)))
        speed = float(rng.choice([0.0, 0.3, 1.0], p=[0.1, 0.2, 0.7]) * rng.uniform(0.3, 1.0) * fastest)
        # What a turn at speed may pull sideways, m/s².
        limit = min(1.2, 2.0 / max(speed, 0.1))
        yaw_rate = float(rng.choice([0.0, 1.0], p=[0.3, 0.7]) * rng.uniform(-limit, limit))
        legs.append(Leg(length, speed, yaw_rate))
        left -= length
    legs.append(Leg(legs[0].duration, 0.0))
    return scripted(legs)


def path(inputs: Inputs, heading: float = 0.0) -> tuple[Array, Array, Array, Array]:
    """t (s), x, y (m, from the start) and heading (rad, anticlockwise from x) on a 10 ms grid."""
    start, end = inputs.speed.start, inputs.speed.end
    t = np.arange(start, end + 0.5 * _STEP, _STEP)
    # Simpson's rule on each step: the error is far below a micrometre for a vehicle's motion.
    at = np.sort(np.concatenate([t, t[:-1] + 0.5 * _STEP]))
    course = heading + inputs.yaw_rate.integral(at)
    speed = inputs.speed(at)
    x = np.concatenate([[0.0], np.cumsum(_simpson(speed * np.cos(course)))])
    y = np.concatenate([[0.0], np.cumsum(_simpson(speed * np.sin(course)))])
    return t, x, y, course[::2]


def _simpson(value: Array) -> Array:
    return np.asarray(_STEP / 6.0 * (value[:-2:2] + 4.0 * value[1:-1:2] + value[2::2]))
