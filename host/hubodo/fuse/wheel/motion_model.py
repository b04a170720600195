"""Propagation of states and covariance from the middle of a window to its end.

The vehicle moves along the chord of an arc at the mean speed and yaw rate of the window. Each wheel turns at
its mean rate. Entries with a finite correlation time are first-order Gauss-Markov processes. All others are
random walks. Beyond first order, heading errors shorten the path: `HeadingErrorInflation`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.axle_rate import mean_axle_rate
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    HEADING,
    RATE_BEYOND_RANGE,
    SPEED,
    TRACK_WIDTH,
    WHEEL_ANGLE,
    WHEEL_RADIUS,
    YAW_RATE,
    Entry,
    StateLayout,
    X,
    Y,
)
from hubodo.fuse.wheel.records import POSE_ENTRIES, StateTransition, WheelWindows
from hubodo.fuse.wheel.state_vector import InitialState
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, Window

_VEHICLE_ROWS = (
    (X, (HEADING, SPEED, YAW_RATE)),
    (Y, (HEADING, SPEED, YAW_RATE)),
    (HEADING, (YAW_RATE,)),
)
"""Vehicle entries that change within a window, and the entries they depend on besides themselves."""

_WHEEL_ROW = (WHEEL_ANGLE, (GYRO_SCALE_Z, GYRO_BIAS_Z, RATE_BEYOND_RANGE, CAMBER, YAW_RATE))
"""Wheel entry that changes within a window, and the entries it depends on besides itself."""


_FOLLOWED_RATE_SIGMA = 0.2
"""rad/s, 1 sigma of the rate of a wheel that is not received for a window while the other one is received.
Estimated.
"""


class MotionModel:
    """Propagation of states and covariance; the derivatives of the last window are stored."""

    def __init__(self, config: WheelConfig, initial: InitialState) -> None:
        layout = initial.columns
        gauss_markov = [entry for entry in layout.vehicle if math.isfinite(entry.correlation_time)]
        vehicle_rows = (*_VEHICLE_ROWS, *((entry, (entry,)) for entry in gauss_markov))
        # Only these states change within a window, so only their rows of the transition are stored.
        self._count = layout.n_propagated
        self._rows = np.eye(self._count, layout.size)
        self._variable_elements = _variable_elements(layout, vehicle_rows)
        self._nonzero = np.union1d(self._variable_elements, np.flatnonzero(self._rows))
        # `struct` copies a list of floats into an array in half the time of numpy.
        self._pack = struct.Struct(f"{len(self._variable_elements)}d").pack_into
        self._values = np.empty(len(self._variable_elements))
        self._buffer, self._flat_rows = self._values.data, self._rows.ravel()
        self._propagated = range(self._count)
        self._columns = layout.vehicle
        # The process noise of x and y depends on the distance; it is set for each window.
        self._walk = initial.walk_variances * WINDOW_S
        self._angle_walk = float(self._walk[layout.wheels[0][WHEEL_ANGLE]])
        self._lateral_slip = config.noise.lateral_slip**2
        self._decays = [math.exp(-WINDOW_S / entry.correlation_time) for entry in gauss_markov]
        self._decaying = list(
            zip((layout.vehicle[entry] for entry in gauss_markov), self._decays, strict=True)
        )
        for column, decay in self._decaying:
            self._walk[column] = initial.p[column, column] * (1.0 - decay * decay)

    def advance(self, x: list[float], p: Array, windows: WheelWindows) -> None:
        """Propagate x and p in place to the end of the window."""
        columns = self._columns
        at_x, at_y, at_heading = columns[X], columns[Y], columns[HEADING]
        t, speed, yaw_rate = WINDOW_S, x[columns[SPEED]], x[columns[YAW_RATE]]
        turn = yaw_rate * t
        course = x[at_heading] + 0.5 * turn
        # Chord of an arc, to second order of its angle.
        chord_ratio = 1.0 - turn * turn / 24.0
        chord = speed * t * chord_ratio
        cos, sin = math.cos(course), math.sin(course)
        x[at_x] += chord * cos
        x[at_y] += chord * sin
        x[at_heading] += turn
        for column, decay in self._decaying:
            x[column] *= decay
        half = 0.5 * t * chord
        values = [-chord * sin, t * chord_ratio * cos, -half * sin]
        values += [chord * cos, t * chord_ratio * sin, half * cos, t, *self._decays]
        for wheel, window in windows:
            values += _turn_wheel(x, wheel, window, yaw_rate)
        rows, count = self._rows, self._count
        self._pack(self._buffer, 0, *values)
        self._flat_rows[self._variable_elements] = self._values
        new_rows = rows.dot(p)
        p[:count] = new_rows
        p[:, :count] = new_rows.T
        p[:count, :count] = new_rows.dot(rows.T)
        # Lateral slip moves the vehicle across its heading.
        slip_variance = self._lateral_slip * abs(chord)
        self._walk[at_x], self._walk[at_y] = slip_variance * sin * sin, slip_variance * cos * cos
        covariance = slip_variance * sin * cos
        p[at_x, at_y] = p.item(at_x, at_y) - covariance
        p[at_y, at_x] = p.item(at_y, at_x) - covariance
        diagonal = p.ravel()[:: len(x) + 1]
        diagonal += self._walk
        for wheel, window in windows:
            angle = wheel.columns[WHEEL_ANGLE]
            excess = wheel.standstill.noise * t * t - self._angle_walk
            if excess > 0.0:
                p[angle, angle] += excess
            if window.missing > 0.0:
                rate_sigma = _FOLLOWED_RATE_SIGMA if window is EMPTY_WINDOW else 1.0
                p[angle, angle] += (rate_sigma * window.missing * t) ** 2

    def transition(self) -> StateTransition:
        """Return the last propagation as a change of the states."""
        return StateTransition(self._propagated, self._nonzero, self._flat_rows.take(self._nonzero))


def _turn_wheel(x: list[float], wheel: Wheel, window: Window, yaw_rate: float) -> tuple[float, ...]:
    """Propagate the wheel angle in place and return its derivatives in the order of `_WHEEL_ROW`."""
    t, columns, side = WINDOW_S, wheel.columns, wheel.geometry.side
    about_axle = mean_axle_rate(x, columns, window)
    camber, angle = x[columns[CAMBER]], columns[WHEEL_ANGLE]
    if window is EMPTY_WINDOW:
        # The wheel follows the vehicle, whose motion another wheel measures.
        contact = wheel.geometry.contact_y * (1.0 + x[columns[TRACK_WIDTH]])
        radius = wheel.geometry.radius * (1.0 + x[columns[WHEEL_RADIUS]])
        turned = (x[columns[SPEED]] - yaw_rate * contact) / radius * t
        x[angle] = math.remainder(x[angle] + turned, 2.0 * math.pi)
        return 0.0, 0.0, 0.0, 0.0, -contact / radius * t
    sin = math.sin(camber)
    rate = about_axle.rate - side * yaw_rate * sin
    x[angle] = math.remainder(x[angle] + rate * t, 2.0 * math.pi)
    by_camber, by_yaw_rate = -side * yaw_rate * math.cos(camber) * t, -side * sin * t
    return about_axle.scale_derivative * t, about_axle.bias_derivative * t, t, by_camber, by_yaw_rate


def _variable_elements(layout: StateLayout, vehicle_rows: Sequence[tuple[Entry, tuple[Entry, ...]]]) -> Array:
    """Return the flat indices, in the stored rows of the transition, of all elements that vary."""
    rows = [(layout.vehicle, entry, by) for entry, by in vehicle_rows]
    rows += [(columns, *_WHEEL_ROW) for columns in layout.wheels]
    return np.array(
        [columns[row] * layout.size + columns[entry] for columns, row, by in rows for entry in by]
    )


def relative_length_loss(variance: float) -> float:
    """Return the rms relative shortening of a path whose heading error d has a variance, rad².

    √E(1 - cos d)² for normal d; √(3/4) times the variance if that is small. First-order propagation only
    moves the path sideways.
    """
    mean_square = 1.5 - 2.0 * math.exp(-0.5 * variance) + 0.5 * math.exp(-2.0 * variance)
    # Below a microradian rounding can make the square negative.
    return math.sqrt(max(mean_square, 0.0))


@dataclass
class HeadingErrorInflation:
    """Sum of path segments, each scaled by the relative shortening of its heading error.

    Heading errors of all segments are assumed to be fully correlated, as from a gyro scale error, which is
    an upper bound (Cov² is at most the product of the variances). So displacements add up, not their
    variances. x, y: m, the sum.
    """

    x: float = 0.0
    y: float = 0.0
    _last_position: tuple[float, float] = (0.0, 0.0)

    def advance(self, x: float, y: float, variance: float) -> None:
        """Add the segment up to x, y (m) with a heading variance, rad²."""
        relative = relative_length_loss(variance)
        before_x, before_y = self._last_position
        self.x += relative * (x - before_x)
        self.y += relative * (y - before_y)
        self._last_position = x, y

    @property
    def covariance(self) -> Array:
        """Return the second-order covariance of a pose, (5, 5): of x and y, m²; all else is zero."""
        covariance = np.zeros((len(POSE_ENTRIES), len(POSE_ENTRIES)))
        covariance[0, 0], covariance[1, 1] = self.x * self.x, self.y * self.y
        covariance[0, 1] = covariance[1, 0] = self.x * self.y
        return covariance
