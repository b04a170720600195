"""The wheel filter's states and covariance from the middle of a window to its end."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel import phase
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.preintegration import WINDOW, Window
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.update import Pairs


class WheelMotion:
    """Carries states and covariance on; remembers the transition of the last window.

    walk: (n,) variance per second by which each of the states wanders.
    """

    def __init__(self, config: WheelConfig, wheels: list[Wheel], walk: Array) -> None:
        size = len(walk)
        # Only these states move within a window; their rows of the transition are all that is kept of it.
        self._moved = np.array(
            [phase.X, phase.Y, phase.HEADING, phase.SLOPE, *(wheel.first + phase.ANGLE for wheel in wheels)]
        )
        self._crossings = self._moved[:, None] * size + self._moved
        self._rows = np.eye(size)[self._moved]
        self._entries = _transition_places([wheel.first for wheel in wheels], size)
        self._walk = walk * WINDOW
        self._lateral = config.noise.lateral**2
        self._fade = math.exp(-WINDOW / config.noise.slope_time)
        self._slope = config.noise.slope**2 * (1.0 - self._fade * self._fade)

    def advance(self, x: list[float], p: Array, pairs: Pairs) -> None:
        """x and p, at the mean rates of the window, to its end; both in place."""
        t, speed, yaw_rate = WINDOW, x[phase.SPEED], x[phase.YAW_RATE]
        turn = yaw_rate * t
        course = x[phase.HEADING] + 0.5 * turn
        # The chord of an arc, to the second order of its angle.
        short = 1.0 - turn * turn / 24.0
        chord = speed * t * short
        cos, sin = math.cos(course), math.sin(course)
        x[phase.X] += chord * cos
        x[phase.Y] += chord * sin
        x[phase.HEADING] += turn
        x[phase.SLOPE] *= self._fade
        half = 0.5 * t * chord
        values = [-chord * sin, t * short * cos, -half * sin]
        values += [chord * cos, t * short * sin, half * cos, t, self._fade]
        for wheel, window in pairs:
            values += _turn_wheel(x, wheel, window, yaw_rate)
        rows, moved = self._rows, self._moved
        rows.ravel()[self._entries] = values
        new = rows.dot(p)
        p[moved] = new
        p[:, moved] = new.T
        p.ravel()[self._crossings] = new.dot(rows.T)
        diagonal = p.ravel()[:: len(x) + 1]
        diagonal += self._walk
        rolled = self._lateral * abs(chord)
        p[phase.X, phase.X] += rolled * sin * sin
        p[phase.Y, phase.Y] += rolled * cos * cos
        p[phase.X, phase.Y] -= rolled * sin * cos
        p[phase.Y, phase.X] -= rolled * sin * cos
        p[phase.SLOPE, phase.SLOPE] += self._slope
        for wheel, window in pairs:
            if window.missing > 0.0:
                p[wheel.first, wheel.first] += (window.missing * t) ** 2

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last window by those at its beginning, (n, n)."""
        whole = np.eye(self._rows.shape[1])
        whole[self._moved] = self._rows
        return whole


def _turn_wheel(x: list[float], wheel: Wheel, window: Window, yaw_rate: float) -> tuple[float, ...]:
    """The wheel angle to the end of the window; its derivatives in the order of `_transition_places`."""
    t, first, side = WINDOW, wheel.first, wheel.geometry.side
    scale = 1.0 + x[first + phase.SPIN_SCALE]
    seen = (window.spin / t - x[first + phase.SPIN_BIAS]) / scale
    lean = x[first + phase.CAMBER]
    sin = math.sin(lean)
    rate = seen + x[first + phase.EXCESS] - side * yaw_rate * sin
    x[first + phase.ANGLE] = math.remainder(x[first + phase.ANGLE] + rate * t, 2.0 * math.pi)
    return -seen / scale * t, -t / scale, t, -side * yaw_rate * math.cos(lean) * t, -side * sin * t


def _transition_places(firsts: list[int], size: int) -> Array:
    """Places in the kept rows of the transition of all numbers that change from window to window."""
    heading, speed, yaw = phase.HEADING, phase.SPEED, phase.YAW_RATE
    places = [(row, column) for row in (0, 1) for column in (heading, speed, yaw)]
    places += [(2, yaw), (3, phase.SLOPE)]
    for row, first in enumerate(firsts, 4):
        own = (phase.SPIN_SCALE, phase.SPIN_BIAS, phase.EXCESS, phase.CAMBER)
        places += [(row, first + state) for state in own]
        places.append((row, yaw))
    return np.array([row * size + column for row, column in places])
