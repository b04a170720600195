"""What the windows of all wheels say at once, worked into the states of the wheel filter."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from operator import add
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpotrf, dtrtri

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel import phase, two_wheels
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.phase import ROWS, VEHICLE_STATES, WHEEL_STATES
from hubodo.fuse.wheel.preintegration import WINDOW, Window
from hubodo.fuse.wheel.state import Wheel

Pairs = Sequence[tuple[Wheel, Window]]
"""Each wheel with its window, in the order of the nodes."""


class Updated(NamedTuple):
    """x, p: the states and their covariance with the measurements. nis, degrees: squared innovations over
    their variance, and how many there were. rates: rad/s of each wheel, yaws: rad/s of the vehicle as each
    wheel's gyro feels it."""

    x: list[float]
    p: Array
    nis: float
    degrees: int
    rates: list[float]
    yaws: list[float]


class WheelUpdate:
    """The measurement rows of one window of each wheel, and their Kalman update. It remembers nothing."""

    def __init__(self, config: WheelConfig) -> None:
        self._count = len(config.nodes)
        self._size = VEHICLE_STATES + self._count * WHEEL_STATES
        self._rows = self._count * ROWS
        self._noise = _RowNoise(config)
        # One array for the Jacobian, the residuals and their variances: filled at once for all wheels.
        places: list[int] = []
        jacobian = self._rows * self._size
        for index in range(self._count):
            for row, column in zip(*phase.jacobian_places(index, self._count), strict=True):
                places.append(row * self._size + column)
            own = [phase.row_place(index, row, self._count) for row in range(ROWS)]
            places += [jacobian + row for row in own]
            places += [jacobian + self._rows + row for row in own]
        self._places = np.array(places)
        self._table = np.zeros(jacobian + 2 * self._rows)
        # Takes a list of floats into an array in half the time that numpy does.
        self._packing = f"{len(places)}d"
        self._values = np.empty(len(places))

    def work_in(self, x: list[float], p: Array, pairs: Pairs, resting: bool) -> Updated:
        """x: (n,), p: (n, n), C-contiguous; may be overwritten. resting: the vehicle stands still."""
        rates, yaws, out = self._gather(x, pairs, resting)
        h = self._table[: -2 * self._rows].reshape(self._rows, self._size)
        z, r = self._table[-2 * self._rows : -self._rows], self._table[-self._rows :]
        if out:
            pick = np.delete(np.arange(self._rows), out)
            if not len(pick):
                return Updated(x, p, 0.0, 0, rates, yaws)
            h, z, r = h[pick], z[pick], r[pick]
        # `dot` spends half the time of `@` on matrices of this size.
        hp = h.dot(p)
        s = hp.dot(h.T)
        diagonal = s.ravel()[:: len(z) + 1]
        diagonal += r
        whiten = _whitening(s)
        white = whiten.dot(z)
        if white.dot(white) > two_wheels.GATE**2:
            sigma = 1.0 / whiten.diagonal()
            wider, slipping = two_wheels.robust_variances(white, sigma, z, r, not out, self._count)
            if slipping is not None:
                pairs[slipping][0].slips += 1
            diagonal += wider - r
            whiten = _whitening(s)
            white = whiten.dot(z)
        root = whiten.dot(hp)
        x = list(map(add, x, white.dot(root).tolist()))
        # p - root' root in one go. To BLAS, which counts by columns, `.T` is the array as it lies.
        p = dgemm(-1.0, root.T, root.T, beta=1.0, c=p.T, trans_b=1, overwrite_c=1).T
        return Updated(x, p, float(white.dot(white)), len(z), rates, yaws)

    def _gather(
        self, x: list[float], pairs: Pairs, resting: bool
    ) -> tuple[list[float], list[float], list[int]]:
        """All rows into the table. Returns the wheels' rates, the yaw rates they feel, rows without a say."""
        values: list[float] = []
        rates: list[float] = []
        yaws: list[float] = []
        out: list[int] = []
        vehicle = x[:VEHICLE_STATES]
        for index, (wheel, window) in enumerate(pairs):
            states = x[wheel.first : wheel.first + WHEEL_STATES]
            residuals, derivatives, rate = phase.wheel_rows(vehicle, states, window, wheel.geometry)
            values += derivatives
            values += residuals
            values += self._noise.variances(window, rate, resting)
            rates.append(rate)
            yaws.append(
                vehicle[phase.YAW_RATE] + residuals[phase.YAW] / WINDOW / math.cos(states[phase.CAMBER])
            )
            if not (wheel.joined and wheel.trusted) or window.missing or _clipped(window):
                out += [phase.row_place(index, row, self._count) for row in _unusable(wheel, window)]
        struct.pack_into(self._packing, self._values.data, 0, *values)
        self._table[self._places] = self._values
        return rates, yaws, out


class _RowNoise:
    """Variances of the rows of a wheel's window."""

    def __init__(self, config: WheelConfig) -> None:
        noise, t = config.noise, WINDOW
        self._gyro, self._accel = noise.gyro**2 * t, noise.accel**2 * t
        self._roll, self._flex = (noise.roll * t) ** 2, (noise.flex * t) ** 2
        self._push, self._sway = (noise.push * t) ** 2, (noise.sway * t) ** 2
        self._clipped_push = (2.0 * STANDARD_GRAVITY / 10.0 * t) ** 2
        self._vibration, self._road = (noise.vibration * t) ** 2, noise.road**2 * config.radius * t
        still = self._accel + (0.02 * t) ** 2
        self._resting = (self._gyro, self._gyro, still, still, 2e-5**2)

    def variances(self, window: Window, rate: float, resting: bool) -> tuple[float, ...]:
        """Of the rows of `phase`; rate: rad/s of the wheel."""
        if resting:
            return self._resting
        rates = self._gyro + self._flex * window.axial_variance
        forces = self._accel + self._vibration * window.axial_variance
        push = self._push if window.spin_clipped == 0.0 else self._clipped_push
        road = self._road * abs(rate) + 1e-8
        made = (rates, rates + self._roll, forces + push, forces + self._sway, road)
        if window.missing == 0.0:
            return made
        share = 1.0 + 1e4 * window.missing
        return tuple(variance * share for variance in made)


def _clipped(window: Window) -> bool:
    return window.spin_clipped > 0.0 or window.across_clipped > 0.0 or window.force_clipped > 0.0


def _unusable(wheel: Wheel, window: Window) -> list[int]:
    """The rows of a wheel that say nothing in this window."""
    if not wheel.joined or window.missing >= 0.5:
        return list(range(ROWS))
    rows: list[int] = []
    if window.across_clipped > 0.0:
        rows += [phase.YAW, phase.ROLL]
    if window.force_clipped > 0.0:
        rows.append(phase.FORWARD)
    if window.force_clipped > 0.0 or window.spin_clipped > 0.0:
        rows.append(phase.SIDEWAYS)
    return rows if wheel.trusted else [*rows, phase.ROLLING]


def _whitening(s: Array) -> Array:
    """Inverse of the lower Cholesky factor of the innovation covariance: makes each innovation, given those
    before it, a number of sigma 1. (Solving with the factor instead wakes the threads of BLAS, a hundred
    times slower.)"""
    factor, _ = dpotrf(s, lower=1, clean=1)
    inverse: Array
    inverse, _ = dtrtri(factor, lower=1, overwrite_c=1)
    return inverse
