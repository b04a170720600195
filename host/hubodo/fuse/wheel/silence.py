"""Where a vehicle may be after a time in which no wheel was heard: what vehicles do, in closed form.

Speed v and yaw rate r go on from where they were as Ornstein-Uhlenbeck processes that return to zero,

    dv = -v dt / T_v + V sqrt(2 / T_v) dw,    dr = -r dt / T_r + R sqrt(2 / T_r) dw',

and the way is the integral of v e^(i theta), theta' = r. Its mean and covariance are those of these processes
(theta is Gaussian: E e^(i theta) = e^(i m - s²/2)), by Gauss-Legendre quadrature: they take the same time for
a second and for a day, and a vehicle whose heading is lost does not run away on the tangent.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import EXCESS, HEADING, SPEED, WHEEL_ANGLE, YAW_RATE, X, Y
from hubodo.fuse.wheel.state import InitialState
from hubodo.fuse.wheel.window import WINDOW

_SPEED, _FASTER, _SPEED_TIME = 2.0, 1.5, 16.0
"""V is 2 m/s, a brisk walk, or one and a half times the fastest so far; T_v is 16 s.

So a walking vehicle is believed to change its speed by 0.7 m/s within the first second. Estimated.
"""

_YAW_RATE, _SIDEWAYS, _YAW_TIME = 0.35, 2.0, 2.0
"""R is 0.35 rad/s, a bend that a walker takes, or what 2 m/s² to the side allow at V; T_r is 2 s.
Estimated.
"""

_LONG = 60.0
"""s after which the start is forgotten and the variance of the way grows evenly: many times T_v and T_r."""

UNKNOWN = math.pi / math.sqrt(3.0)
"""rad, 1 sigma of a direction of which nothing is known: that of the uniform distribution."""

_HERE, _SHARE = np.polynomial.legendre.leggauss(24)
_NODES, _WEIGHTS = 0.5 * (_HERE + 1.0), 0.5 * _SHARE
_ORDER = (X, Y, HEADING, SPEED, YAW_RATE)


class Agility(NamedTuple):
    """V in m/s and R in rad/s of a vehicle."""

    speed: float
    yaw_rate: float


def agility(fastest: float) -> Agility:
    """Of a vehicle that has been seen to go at `fastest`, m/s."""
    speed = max(_SPEED, _FASTER * fastest)
    return Agility(speed, min(_YAW_RATE, _SIDEWAYS / speed))


def window_walk(able: Agility) -> tuple[float, float]:
    """Variances of speed, (m/s)², and yaw rate, (rad/s)², that a window adds in which they are not seen."""
    return (
        2.0 * able.speed**2 * WINDOW / _SPEED_TIME,
        2.0 * able.yaw_rate**2 * WINDOW / _YAW_TIME,
    )


class FreeMotion(NamedTuple):
    """What becomes of a vehicle within a time, in axes of its heading at the beginning.

    way: m, mean, forward + i left; by_speed, by_yaw_rate: its derivatives by speed and yaw rate at the
    beginning. turn: s, of the heading by the yaw rate. speed, yaw_rate: shares of both that are left. noise:
    (5, 5), covariance that is new, of forward, left, heading, speed, yaw rate.
    """

    way: complex
    by_speed: complex
    by_yaw_rate: complex
    turn: float
    speed: float
    yaw_rate: float
    noise: Array


def free_motion(speed: float, yaw_rate: float, seconds: float, able: Agility) -> FreeMotion:
    """Of a vehicle at `speed`, m/s, and `yaw_rate`, rad/s."""
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
    # What heading, speed and yaw rate at the end have in common with the way.
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
    known = min(1.0, UNKNOWN / math.sqrt(noise[2, 2]))
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
    """rad², of the headings at times s and u, s: the integral of an Ornstein-Uhlenbeck process from zero."""
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
    """(2, 2) m² of the way: E of v_s v_u e^(i theta_s) e^(-+i theta_u) over all pairs of times."""
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
    """m²/s by which each direction's variance grows when the start is forgotten.

    Green-Kubo: the integral of the autocorrelation of v e^(i theta).
    """
    s = _LONG * _NODES**2
    weight = 2.0 * _LONG * _NODES * _WEIGHTS
    ratio = s / _YAW_TIME
    turned = (able.yaw_rate * _YAW_TIME) ** 2 * (ratio - 1.0 + np.exp(-ratio))
    return float(np.sum(weight * able.speed**2 * np.exp(-s / _SPEED_TIME - turned)))


class SilenceMotion:
    """Carries the wheel filter's states and covariance over a silence of any length in one step."""

    def __init__(self, config: WheelConfig, begin: InitialState) -> None:
        columns = begin.columns
        self._at = columns.vehicle
        self._walk = begin.walk.copy()
        self._most = np.full(columns.size, np.inf)
        self._fading: list[tuple[int, float, float]] = []
        self._wheels = [(at[WHEEL_ANGLE], at[EXCESS]) for at in columns.wheels]
        for at in columns.wheels:
            for entry, place in at.items():
                # However long it wanders, it is one of the things that a prior tells of.
                self._most[place] = max(entry.prior**2, begin.p[place, place])
        for entry, place in columns.vehicle.items():
            if math.isfinite(entry.forgets):
                self._fading.append((place, entry.forgets, begin.p[place, place]))

    def advance(
        self, x: list[float], p: Array, seconds: float, able: Agility, stands: bool
    ) -> tuple[Array, float]:
        """x and p to the end of the silence, both in place.

        stands: whether the vehicle stood before it. Returns the transition (n, n), and the variance of the
        heading that is new, rad².
        """
        at = [self._at[entry] for entry in _ORDER]
        if stands:
            x[at[3]] = x[at[4]] = 0.0
        made = free_motion(x[at[3]], x[at[4]], seconds, able)
        ahead = complex(math.cos(x[at[2]]), math.sin(x[at[2]]))
        transition = np.eye(len(x))
        for column, change in (
            (at[2], 1j * made.way * ahead),
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
        way = made.way * ahead
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
            # Whether it has turned may show when it is heard again: kept apart from all else.
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
            diagonal[angle] = UNKNOWN**2
