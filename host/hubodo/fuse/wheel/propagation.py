"""The wheel filter's states and covariance from the middle of a window to its end.

The vehicle goes along the chord of an arc at the mean speed and yaw rate of the window; each wheel turns on
at its mean rate; an entry that forgets is a Gauss-Markov process of first order; every other one stays, and
wanders as its effect says.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    HEADING,
    RATE_BEYOND_RANGE,
    SPEED,
    WHEEL_ANGLE,
    YAW_RATE,
    Entry,
    StateLayout,
    X,
    Y,
)
from hubodo.fuse.wheel.measurement_update import WheelWindows
from hubodo.fuse.wheel.state import InitialState, Wheel
from hubodo.fuse.wheel.window import WINDOW_S, Window

_VEHICLE = (
    (X, (HEADING, SPEED, YAW_RATE)),
    (Y, (HEADING, SPEED, YAW_RATE)),
    (HEADING, (YAW_RATE,)),
)
"""The entries of the vehicle that move within a window, and by which they do, beside themselves."""

_WHEEL = (WHEEL_ANGLE, (GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE, CAMBER, YAW_RATE))
"""The same of each wheel."""


class MotionModel:
    """Carries states and covariance on; remembers the transition of the last window."""

    def __init__(self, config: WheelConfig, begin: InitialState) -> None:
        columns = begin.columns
        fading = [entry for entry in columns.vehicle if math.isfinite(entry.correlation_time)]
        moving = (*_VEHICLE, *((entry, (entry,)) for entry in fading))
        # Only these states move within a window; their rows of the transition are all that is kept of it.
        self._moved = np.array(
            [*(columns.vehicle[entry] for entry, _ in moving), *(at[_WHEEL[0]] for at in columns.wheels)]
        )
        self._crossings = self._moved[:, None] * columns.size + self._moved
        self._rows = np.eye(columns.size)[self._moved]
        self._entries = _transition_places(columns, moving)
        # Takes a list of floats into an array in half the time that numpy does.
        self._packing, self._values = f"{len(self._entries)}d", np.empty(len(self._entries))
        self._at = columns.vehicle
        # Of these, what x and y gain depends on the way: it is put in for each window.
        self._walk = begin.walk * WINDOW_S
        self._lateral = config.noise.lateral_slip**2
        self._fades = [math.exp(-WINDOW_S / entry.correlation_time) for entry in fading]
        self._fading = list(zip((columns.vehicle[entry] for entry in fading), self._fades, strict=True))
        for place, fade in self._fading:
            self._walk[place] = begin.p[place, place] * (1.0 - fade * fade)

    def advance(self, x: list[float], p: Array, pairs: WheelWindows) -> None:
        """x and p, at the mean rates of the window, to its end; both in place."""
        at = self._at
        at_x, at_y, at_heading = at[X], at[Y], at[HEADING]
        t, speed, yaw_rate = WINDOW_S, x[at[SPEED]], x[at[YAW_RATE]]
        turn = yaw_rate * t
        course = x[at_heading] + 0.5 * turn
        # The chord of an arc, to the second order of its angle.
        short = 1.0 - turn * turn / 24.0
        chord = speed * t * short
        cos, sin = math.cos(course), math.sin(course)
        x[at_x] += chord * cos
        x[at_y] += chord * sin
        x[at_heading] += turn
        for place, fade in self._fading:
            x[place] *= fade
        half = 0.5 * t * chord
        values = [-chord * sin, t * short * cos, -half * sin]
        values += [chord * cos, t * short * sin, half * cos, t, *self._fades]
        for wheel, window in pairs:
            values += _turn_wheel(x, wheel, window, yaw_rate)
        rows, moved = self._rows, self._moved
        struct.pack_into(self._packing, self._values.data, 0, *values)
        rows.ravel()[self._entries] = self._values
        new = rows.dot(p)
        p[moved] = new
        p[:, moved] = new.T
        p.ravel()[self._crossings] = new.dot(rows.T)
        # What a vehicle slides sideways is across its course.
        rolled = self._lateral * abs(chord)
        self._walk[at_x], self._walk[at_y] = rolled * sin * sin, rolled * cos * cos
        p[at_x, at_y] -= rolled * sin * cos
        p[at_y, at_x] -= rolled * sin * cos
        diagonal = p.ravel()[:: len(x) + 1]
        diagonal += self._walk
        for wheel, window in pairs:
            angle = wheel.columns[WHEEL_ANGLE]
            p[angle, angle] += max(0.0, wheel.standstill.noise * t * t - self._walk[angle])
            if window.missing > 0.0:
                p[angle, angle] += (window.missing * t) ** 2

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last window by those at its beginning, (n, n)."""
        whole = np.eye(self._rows.shape[1])
        whole[self._moved] = self._rows
        return whole


def _turn_wheel(x: list[float], wheel: Wheel, window: Window, yaw_rate: float) -> tuple[float, ...]:
    """The wheel angle to the end of the window; its derivatives in the order of `_WHEEL`."""
    t, at, side = WINDOW_S, wheel.columns, wheel.geometry.side
    if window.all_clipped:
        seen, by_scale, by_bias = window.spin / t, 0.0, 0.0
    else:
        scale = 1.0 + x[at[GYRO_SCALE_Z]]
        seen = (window.spin / t - x[at[GYRO_BIAS_Z]]) / scale
        by_scale, by_bias = -seen / scale * t, -t / scale
    lean, angle = x[at[CAMBER]], at[WHEEL_ANGLE]
    sin = math.sin(lean)
    rate = seen + x[at[RATE_BEYOND_RANGE]] - side * yaw_rate * sin
    x[angle] = math.remainder(x[angle] + rate * t, 2.0 * math.pi)
    return by_scale, by_bias, t, -side * yaw_rate * math.cos(lean) * t, -side * sin * t


def _transition_places(columns: StateLayout, moving: Sequence[tuple[Entry, tuple[Entry, ...]]]) -> Array:
    """Places in the kept rows of the transition of all numbers that change from window to window."""
    rows: list[tuple[dict[Entry, int], tuple[Entry, ...]]] = [(columns.vehicle, by) for _, by in moving]
    rows += [(at, _WHEEL[1]) for at in columns.wheels]
    return np.array([row * columns.size + at[entry] for row, (at, by) in enumerate(rows) for entry in by])
