"""Motion of a vehicle during an outage, in which no wheel was received, in closed form.

Speed v and yaw rate r revert to zero as Ornstein-Uhlenbeck processes,

    dv = -v dt / T_v + V sqrt(2 / T_v) dw,    dr = -r dt / T_r + R sqrt(2 / T_r) dw',

and the displacement is the integral of v e^(iθ), θ' = r. Mean and covariance of these processes follow by
Gauss-Legendre quadrature (θ is Gaussian: E e^(iθ) = e^(im - s²/2) with mean m and variance s²). The cost is
the same for a second and a day, and a vehicle with unknown heading does not run away on the tangent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import HEADING, RATE_BEYOND_RANGE, SPEED, WHEEL_ANGLE, YAW_RATE, X, Y
from hubodo.fuse.wheel.state import InitialState
from hubodo.fuse.wheel.window import WINDOW_S

_SPEED, _FASTER, _SPEED_TIME = 2.0, 1.5, 16.0
"""Stationary sigma V of the speed: 2 m/s, a brisk walk, or 1.5 times the maximum speed so far. T_v: 16 s.

A walking vehicle is so expected to change its speed by 0.7 m/s within the first second. Estimated.
"""

_YAW_RATE, _SIDEWAYS, _YAW_TIME = 0.35, 2.0, 2.0
"""Stationary sigma R of the yaw rate: 0.35 rad/s, a walker's bend, or 2 m/s² of lateral acceleration at V.
T_r: 2 s. Estimated.
"""

_LONG = 60.0
"""s after which the start is forgotten and position variance grows linearly: many times T_v and T_r."""

UNIFORM_ANGLE_SIGMA = math.pi / math.sqrt(3.0)
"""rad, standard deviation of the uniform distribution over all directions."""

_HERE, _SHARE = np.polynomial.legendre.leggauss(24)
_NODES, _WEIGHTS = 0.5 * (_HERE + 1.0), 0.5 * _SHARE
_ORDER = (X, Y, HEADING, SPEED, YAW_RATE)


class Agility(NamedTuple):
    """Stationary standard deviations of speed, V in m/s, and yaw rate, R in rad/s, of a vehicle."""

    speed: float
    yaw_rate: float


def vehicle_agility(fastest: float) -> Agility:
    """Return the agility of a vehicle that has reached `max_speed`, m/s."""
    speed = max(_SPEED, _FASTER * fastest)
    return Agility(speed, min(_YAW_RATE, _SIDEWAYS / speed))


def free_motion_variances(able: Agility) -> tuple[float, float]:
    """Return the growth of variance per window of an unmeasured speed, (m/s)², and yaw rate, (rad/s)²."""
    return (
        2.0 * able.speed**2 * WINDOW_S / _SPEED_TIME,
        2.0 * able.yaw_rate**2 * WINDOW_S / _YAW_TIME,
    )


class FreeMotion(NamedTuple):
    """Motion of a vehicle during an outage, in axes of its heading at the start.

    Attributes
    ----------
    path : m, mean displacement, forward + i left.
    by_speed, by_yaw_rate : its derivatives by speed and yaw rate at the start, s and m s/rad.
    turn : s, derivative of the final heading by the yaw rate at the start.
    speed, yaw_rate : shares of both that remain at the end.
    noise : (5, 5), process noise of forward, left, heading, speed, yaw rate.
    """

    path: complex
    by_speed: complex
    by_yaw_rate: complex
    turn: float
    speed: float
    yaw_rate: float
    noise: Array


def predict_free_motion(speed: float, yaw_rate: float, seconds: float, able: Agility) -> FreeMotion:
    """Return the motion over `seconds` of a vehicle at `speed`, m/s, and `yaw_rate`, rad/s."""
    t = min(seconds, _LONG)
    s, weight = t * _NODES, t * _WEIGHTS
    keep, turning = np.exp(-s / _SPEED_TIME), np.exp(-s / _YAW_TIME)
    keep_end, turning_end = math.exp(-t / _SPEED_TIME), math.exp(-t / _YAW_TIME)
    turned = _YAW_TIME * (1.0 - turning)
    swing = _heading_covariance(s[:, None], s[None, :], able)
    spread = swing.diagonal()
    toward = np.exp(1j * yaw_rate * turned - 0.5 * spread)
    by_speed = complex(np.sum(weight * keep * toward))
    bend = 1j * speed * weight * keep * toward
    by_yaw_rate = complex(np.sum(bend * turned))
    noise = np.zeros((5, 5))
    noise[:2, :2] = _way_covariance(s, weight, speed, toward, swing, able)
    noise[:2, :2] += np.eye(2) * _steady_growth(able) * (seconds - t)
    # Covariances of heading, speed and yaw rate at the end with the displacement.
    fade = able.yaw_rate**2 * _YAW_TIME * (turning_end / turning - 2.0 * turning_end + turning_end * turning)
    pace = able.speed**2 * keep_end * (1.0 / keep - keep)
    for place, common in enumerate(
        (
            np.sum(bend * _heading_covariance(s, np.full_like(s, t), able)),
            np.sum(weight * pace * toward),
            np.sum(bend * fade),
        ),
        2,
    ):
        noise[:2, place] = noise[place, :2] = common.real, common.imag
    last = np.array([seconds])
    noise[2, 2] = float(_heading_covariance(last, last, able)[0])
    noise[3, 3] = able.speed**2 * (1.0 - keep_end**2)
    noise[4, 4] = able.yaw_rate**2 * (1.0 - turning_end**2)
    noise[2, 4] = noise[4, 2] = able.yaw_rate**2 * _YAW_TIME * (1.0 - turning_end) ** 2
    known = min(1.0, UNIFORM_ANGLE_SIGMA / math.sqrt(noise[2, 2]))
    noise[2, :] *= known
    noise[:, 2] *= known
    return FreeMotion(
        speed * by_speed,
        by_speed,
        by_yaw_rate,
        _YAW_TIME * (1.0 - turning_end),
        keep_end,
        turning_end,
        noise,
    )


def _heading_covariance(s: Array, u: Array, able: Agility) -> Array:
    """Return the covariance of the headings at times s and u (s), rad².

    The heading is an integrated Ornstein-Uhlenbeck process that starts at zero.
    """
    scale = (able.yaw_rate * _YAW_TIME) ** 2
    late, early = np.exp(-s / _YAW_TIME), np.exp(-u / _YAW_TIME)
    apart = np.exp(-np.abs(s - u) / _YAW_TIME)
    found: Array = scale * (
        2.0 * np.minimum(s, u) / _YAW_TIME - 2.0 + 2.0 * (late + early) - apart - late * early
    )
    return found


def _way_covariance(
    s: Array, weight: Array, speed: float, toward: Array, swing: Array, able: Agility
) -> Array:
    """Return the covariance of the displacement, (2, 2) m².

    It is E v_s v_u e^(iθ_s) e^(∓iθ_u), integrated over all pairs of times.
    """
    keep = np.exp(-s / _SPEED_TIME)
    both = keep[:, None] * keep[None, :]
    pace = able.speed**2 * (np.exp(-np.abs(s[:, None] - s[None, :]) / _SPEED_TIME) - both)
    pace += speed * speed * both
    pace *= weight[:, None] * weight[None, :]
    mean = complex(np.sum(weight * speed * keep * toward))
    along = toward[:, None] * np.conj(toward)[None, :] * np.exp(swing)
    across = toward[:, None] * toward[None, :] * np.exp(-swing)
    square, twice = complex(np.sum(pace * along)).real, complex(np.sum(pace * across))
    xx, yy = 0.5 * (square + twice.real), 0.5 * (square - twice.real)
    xy = 0.5 * twice.imag - mean.real * mean.imag
    return np.array([[xx - mean.real**2, xy], [xy, yy - mean.imag**2]])


def _steady_growth(able: Agility) -> float:
    """Return the asymptotic growth of the position variance in each direction, m²/s.

    Green-Kubo: the integral of the autocorrelation of v e^(iθ).
    """
    s = _LONG * _NODES**2
    weight = 2.0 * _LONG * _NODES * _WEIGHTS
    ratio = s / _YAW_TIME
    turned = (able.yaw_rate * _YAW_TIME) ** 2 * (ratio - 1.0 + np.exp(-ratio))
    return float(np.sum(weight * able.speed**2 * np.exp(-s / _SPEED_TIME - turned)))


class OutageModel:
    """Propagation of states and covariance over an outage of any length in one step."""

    def __init__(self, config: WheelConfig, begin: InitialState) -> None:
        columns = begin.columns
        self._at = columns.vehicle
        self._walk = begin.walk.copy()
        self._most = np.full(columns.size, np.inf)
        self._fading: list[tuple[int, float, float]] = []
        self._wheels = [(at[WHEEL_ANGLE], at[RATE_BEYOND_RANGE]) for at in columns.wheels]
        for at in columns.wheels:
            for entry, place in at.items():
                # The variance of a random walk is bounded by its prior however long the outage is.
                self._most[place] = max(entry.prior**2, begin.p[place, place])
        for entry, place in columns.vehicle.items():
            if math.isfinite(entry.correlation_time):
                self._fading.append((place, entry.correlation_time, begin.p[place, place]))

    def advance(
        self, x: list[float], p: Array, seconds: float, able: Agility, stands: bool
    ) -> tuple[Array, float]:
        """Propagate x and p in place to the end of an outage of `seconds`.

        is_stationary: True if the vehicle stood still before it. Return the transition (n, n) and the
        heading variance added, rad².
        """
        at = [self._at[entry] for entry in _ORDER]
        if stands:
            x[at[3]] = x[at[4]] = 0.0
        made = predict_free_motion(x[at[3]], x[at[4]], seconds, able)
        ahead = complex(math.cos(x[at[2]]), math.sin(x[at[2]]))
        transition = np.eye(len(x))
        for column, change in (
            (at[2], 1j * made.path * ahead),
            (at[3], made.by_speed * ahead),
            (at[4], made.by_yaw_rate * ahead),
        ):
            transition[at[0], column], transition[at[1], column] = change.real, change.imag
        transition[at[2], at[4]] = made.turn
        transition[at[3], at[3]], transition[at[4], at[4]] = made.speed, made.yaw_rate
        for place, forgets, _ in self._fading:
            transition[place, place] = math.exp(-seconds / forgets)
        for angle, excess in self._wheels:
            transition[angle, angle] = transition[excess, excess] = 0.0
        way = made.path * ahead
        x[at[2]] += made.turn * x[at[4]]
        x[at[0]] += way.real
        x[at[1]] += way.imag
        x[at[3]] *= made.speed
        x[at[4]] *= made.yaw_rate
        for place, _, _ in self._fading:
            x[place] *= transition[place, place]
        for angle, excess in self._wheels:
            x[angle] = x[excess] = 0.0
        turn = np.eye(5)
        turn[:2, :2] = [[ahead.real, -ahead.imag], [ahead.imag, ahead.real]]
        noise = turn @ made.noise @ turn.T
        if stands:
            # Whether the vehicle has turned may show later: uncorrelated, so that it can be removed again.
            noise = np.diag(noise.diagonal())
        self._spread(p, transition, seconds)
        p[np.ix_(at, at)] += noise
        return transition, float(noise[2, 2])

    def _spread(self, p: Array, transition: Array, seconds: float) -> None:
        p[:] = transition @ p @ transition.T
        diagonal = p.ravel()[:: len(p) + 1]
        room = np.maximum(self._most - diagonal, 0.0)
        diagonal += np.minimum(self._walk * seconds, room)
        for place, forgets, steady in self._fading:
            diagonal[place] += steady * (1.0 - math.exp(-2.0 * seconds / forgets))
        for angle, _ in self._wheels:
            diagonal[angle] = UNIFORM_ANGLE_SIGMA**2
