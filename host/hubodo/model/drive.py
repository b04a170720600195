"""Simulated drives: smooth speed and yaw rate of a vehicle over time, and the resulting path."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hubodo.arrays import Array
from hubodo.model.inputs import MotionInputs
from hubodo.smoothing_spline import fit_interpolating_spline

_DRIVE_STEP = 0.01  # s, sampling of speed and yaw rate
_DRIVE_SMOOTHING = 0.4  # s, 1σ of the Gaussian that rounds the transitions between legs


@dataclass(frozen=True)
class Leg:
    """A leg of a scripted drive: `duration` in s, constant `speed` in m/s and `yaw_rate` in rad/s."""

    duration: float
    speed: float
    yaw_rate: float = 0.0


def scripted_drive(legs: list[Leg], smoothing: float = _DRIVE_SMOOTHING) -> MotionInputs:
    """Return a drive through legs, smoothed with a Gaussian of 1σ = `smoothing` s.

    Raise ValueError for an empty list or a leg without duration.
    """
    if not legs or any(leg.duration <= 0 for leg in legs):
        raise ValueError("a drive needs at least one leg, each of positive duration")
    ends = np.cumsum([leg.duration for leg in legs])
    t = np.arange(0.0, ends[-1] + 0.5 * _DRIVE_STEP, _DRIVE_STEP)
    leg = np.minimum(np.searchsorted(ends, t, side="right"), len(legs) - 1)
    width = smoothing / _DRIVE_STEP
    speed = gaussian_filter1d(np.array([item.speed for item in legs])[leg], width, mode="nearest")
    yaw_rate = gaussian_filter1d(np.array([item.yaw_rate for item in legs])[leg], width, mode="nearest")
    return MotionInputs(fit_interpolating_spline(t, speed), fit_interpolating_spline(t, yaw_rate))


def loop_drive(rng: np.random.Generator, rest_time: float = 8.0, driving_time: float = 60.0) -> MotionInputs:
    """Return a drive of random legs whose heading changes by about one turn, with standstill at both ends.

    rest_time: s, standstill at the start. driving_time: s, between the two standstills.
    """
    legs = [Leg(rest_time, 0.0)]
    remaining = driving_time
    turn = 2.0 * np.pi / driving_time
    while remaining > 0.0:
        duration = min(remaining, float(rng.uniform(4.0, 8.0)))
        yaw_rate = turn + float(rng.uniform(-0.1, 0.1))
        legs.append(Leg(duration, float(rng.uniform(0.8, 1.8)), yaw_rate))
        remaining -= duration
    legs.append(Leg(4.0, 0.0))
    return scripted_drive(legs)


def random_drive(rng: np.random.Generator, duration: float, max_speed: float = 2.5) -> MotionInputs:
    """Return a drive of random legs, turns in both directions and stops, with standstill at both ends.

    duration: s. max_speed: m/s.
    """
    # The standstill lasts at least 4σ of the smoothing, so that the vehicle really stands still.
    legs = [Leg(min(max(0.05 * duration, 4.0 * _DRIVE_SMOOTHING), 0.3 * duration), 0.0)]
    remaining = duration - 2.0 * legs[0].duration
    while remaining > 0.0:
        length = min(remaining, float(rng.uniform(1.5, 6.0)))
        speed = float(rng.choice([0.0, 0.3, 1.0], p=[0.1, 0.2, 0.7]) * rng.uniform(0.3, 1.0) * max_speed)
        # At most 1.2 rad/s, and a lateral acceleration of at most 2 m/s².
        limit = min(1.2, 2.0 / max(speed, 0.1))
        yaw_rate = float(rng.choice([0.0, 1.0], p=[0.3, 0.7]) * rng.uniform(-limit, limit))
        legs.append(Leg(length, speed, yaw_rate))
        remaining -= length
    legs.append(Leg(legs[0].duration, 0.0))
    return scripted_drive(legs)


def integrate_path(inputs: MotionInputs, heading: float = 0.0) -> tuple[Array, Array, Array, Array]:
    """Return t (s), x, y (m, from the start) and heading (rad, anticlockwise from x) on a 10 ms grid.

    heading: rad, initial heading.
    """
    start, end = inputs.speed.start, inputs.speed.end
    t = np.arange(start, end + 0.5 * _DRIVE_STEP, _DRIVE_STEP)
    # Simpson's rule on each step: for the motion of a vehicle the error is far below a micrometre.
    nodes = np.sort(np.concatenate([t, t[:-1] + 0.5 * _DRIVE_STEP]))
    headings = heading + inputs.yaw_rate.integral(nodes)
    speed = inputs.speed(nodes)
    x = np.concatenate([[0.0], np.cumsum(_simpson(speed * np.cos(headings)))])
    y = np.concatenate([[0.0], np.cumsum(_simpson(speed * np.sin(headings)))])
    return t, x, y, headings[::2]


def _simpson(value: Array) -> Array:
    """Return the integral over each step, (N-1,), of values at the steps and their midpoints, (2N-1,)."""
    return np.asarray(_DRIVE_STEP / 6.0 * (value[:-2:2] + 4.0 * value[1:-1:2] + value[2::2]))
