"""What the windows of all wheels say at once, worked into the states of the wheel filter."""

from __future__ import annotations

from collections.abc import Sequence
from operator import add
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpotrf, dtrtri

from hubodo.arrays import Array
from hubodo.fuse.wheel import mounting_check
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    OBSERVABLE_WHEN_ROLLING,
    OBSERVABLE_WHEN_TURNING,
    RATE_BEYOND_RANGE,
    SLOPE,
    WHEEL_ANGLE,
    YAW_RATE,
    StateLayout,
)
from hubodo.fuse.wheel.measurement_rows import MeasurementRows
from hubodo.fuse.wheel.measurements import (
    BETWEEN_WHEELS,
    VALID_WHEN_ROLLING,
    WindowNoise,
    forward,
    roll,
    rolling,
    yaw,
)
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.slip_detector import ForwardResidual
from hubodo.fuse.wheel.state import MAX_MISSING_SHARE, Wheel
from hubodo.fuse.wheel.window import WINDOW_S, Window

WheelWindows = Sequence[tuple[Wheel, Window]]
"""Each wheel with its window, in the order of the nodes."""

_GAP = 1e4
"""How many times the variance grows in a window that is all gap: beyond what any row can tell. Estimated."""

_STANDS_OUT = mounting_check.GATE_SIGMA**2
"""Squared innovations below which no row can be beyond the gate."""

_SIGNAL = 5.0**2
"""Square of the sigmas of noise by which a wheel must turn to show what multiplies its rate. Estimated."""


_LET_IN = (GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_Y, MISALIGNMENT_X)
"""What the gyros across the axle show as it turns with the wheel, the faster the more."""


class UpdateResult(NamedTuple):
    """The states with the measurements, and what those said.

    x, p: the states and their covariance. nis, degrees: squared innovations over their variance, and how many
    there were. rates: rad/s of each wheel, yaws: rad/s of the vehicle as each wheel's gyro feels it. pushes:
    how each wheel's acceleration differs from what its hub feels, None where the window does not tell.
    slipping: the wheel that the other one contradicts, if any. stillness: as it was taken to be.
    """

    x: list[float]
    p: Array
    nis: float
    dof: int
    rolling_rates: list[float]
    yaw_rates: list[float]
    forward_residuals: list[ForwardResidual | None]
    outlier_wheel: int | None
    motion_state: MotionState


class MeasurementUpdate:
    """The measurements of one window of each wheel, and their Kalman update. It remembers nothing."""

    def __init__(self, config: WheelConfig, columns: StateLayout, pushed: bool = True) -> None:
        """pushed: whether anybody asks for the pushes; else they are None."""
        self._pushed = pushed
        self._rows = MeasurementRows(columns)
        self._noise = WindowNoise(config.noise, config.radius)
        self._measures = [measurement.measure for measurement in self._rows.measurements]
        self._yaw, self._forward = (self._rows.measurements.index(one) for one in (yaw, forward))
        wheels = range(len(columns.wheels))
        self._seen_rolling, self._seen_turning = (
            [np.ix_(self._rows.rows_of_wheel(wheel), columns.columns_of(wheel, entries)) for wheel in wheels]
            for entries in (OBSERVABLE_WHEN_ROLLING, OBSERVABLE_WHEN_TURNING)
        )
        self._slope, self._yaw_rate = columns.vehicle[SLOPE], columns.vehicle[YAW_RATE]
        by = [entry for entry in forward.STATES if entry is not YAW_RATE]
        self._felt = [np.array(columns.columns_of(wheel, by)) for wheel in wheels]
        self._felt_together = [places[:, None] * columns.size + places for places in self._felt]
        self._forward_rows = [self._rows.row_of(forward, wheel) for wheel in wheels]
        self._let_in = [columns.columns_of(wheel, _LET_IN) for wheel in wheels]
        self._compared = tuple(
            (self._rows.row_of(yaw, wheel), self._rows.row_of(rolling, wheel)) for wheel in wheels
        )

    def update(self, x: list[float], p: Array, pairs: WheelWindows, stillness: MotionState) -> UpdateResult:
        """x: (n,), p: (n, n), C-contiguous; may be overwritten."""
        values, rates, yaws, clear, out = self._gather(x, pairs, stillness is MotionState.STANDSTILL)
        slipping = None
        h, z, r = self._rows.fill(values)
        for index, (wheel, window) in enumerate(pairs):
            if window.all_clipped:
                self._add_products(p, h, r, wheel, index)
        # Noise times noise is no signal: minutes of it would make up what is to be learnt.
        still = stillness is not MotionState.MOVING
        for index, (wheel, _) in enumerate(pairs):
            if still or rates[index] ** 2 < _SIGNAL * wheel.standstill.noise:
                h[self._seen_rolling[index]] = 0.0
            if still:
                h[self._seen_turning[index]] = 0.0
        pushes = [
            self._push((x, p), (h, z, r), wheel, index) if clear[index] and self._pushed else None
            for index, (wheel, _) in enumerate(pairs)
        ]
        if out:
            pick = [row for row in range(len(z)) if row not in out]
            if not pick:
                return UpdateResult(x, p, 0.0, 0, rates, yaws, pushes, None, stillness)
            h, z, r = h[pick], z[pick], r[pick]
        # `dot` spends half the time of `@` on matrices of this size.
        hp = h.dot(p)
        s = hp.dot(h.T)
        diagonal = s.ravel()[:: len(z) + 1]
        diagonal += r
        whiten = _whitening(s)
        white = whiten.dot(z)
        nis = float(white.dot(white))
        if nis > _STANDS_OUT:
            sigma = 1.0 / whiten.diagonal()
            compared = self._compared if len(pairs) == 2 and not out else None
            wider, slipping = mounting_check.inflate_outlier_variances(white, sigma, z, r, compared)
            if wider is not r:
                diagonal += wider - r
                whiten = _whitening(s)
                white = whiten.dot(z)
                nis = float(white.dot(white))
        root = whiten.dot(hp)
        x = list(map(add, x, white.dot(root).tolist()))
        # p - root' root in one go. To BLAS, which counts by columns, `.T` is the array as it lies.
        p = dgemm(-1.0, root.T, root.T, beta=1.0, c=p.T, trans_b=1, overwrite_c=1).T
        return UpdateResult(x, p, nis, len(z), rates, yaws, pushes, slipping, stillness)

    def _gather(
        self, x: list[float], pairs: WheelWindows, resting: bool
    ) -> tuple[list[float], list[float], list[float], list[bool], list[int]]:
        """All numbers for the rows, the wheels' rates, the yaw rates felt, what is whole, silent rows."""
        values: list[float] = []
        rates: list[float] = []
        yaws: list[float] = []
        clear: list[bool] = []
        out: list[int] = []
        noise, measures, take = self._noise, self._measures, values.extend
        for index, (wheel, window) in enumerate(pairs):
            view = wheel.view
            view.linearise(x, window, resting, wheel.standstill.noise)
            if wheel.geometry.delay_factor:
                view.update_yaw_change()
            residuals: list[float] = []
            variances: list[float] = []
            for measure in measures:
                residual, variance, derivatives = measure(view, noise)
                take(derivatives.values())
                residuals.append(residual)
                variances.append(variance)
            values += residuals
            if window.missing > 0.0:
                # Integrals over a gap are straight lines: what they tell falls off with its share.
                share = 1.0 + _GAP * window.missing
                variances = [variance * share for variance in variances]
            values += variances
            clear.append(wheel.angle_initialised and window.missing == 0.0 and not _clipped(window))
            rates.append(view.rolling_rate)
            yaws.append(view.yaw_rate + residuals[self._yaw] / WINDOW_S / view.camber_cos)
            if not clear[index] or wheel.is_slipping or not (wheel.speed_trusted and wheel.is_used):
                out += self._silent(index, wheel, window)
        return values, rates, yaws, clear, out

    def _add_products(self, p: Array, h: Array, r: Array, wheel: Wheel, index: int) -> None:
        """Adds to yaw and roll what a spin that is found as it goes does to them by chance.

        An angle that is off turns biases and tilts that are off: variance of a product of two errors that are
        independent (Gaussian second-order filter, Jazwinski 1970, 9.3). And the tilt lets in the spin that is
        off, taken as new in each window.
        """
        angle, excess = wheel.columns[WHEEL_ANGLE], wheel.columns[RATE_BEYOND_RANGE]
        middle = np.zeros(len(p))
        middle[angle], middle[excess] = 1.0, 0.5 * WINDOW_S
        off = float(middle @ p @ middle)
        first, second = self._rows.row_of(yaw, index), self._rows.row_of(roll, index)
        let_in = self._let_in[index]
        within = p[np.ix_(let_in, let_in)]
        by_yaw, by_roll = h[first, let_in], h[second, let_in]
        x, at = wheel.view.x, wheel.columns
        tilt = x[at[MISALIGNMENT_X]] ** 2 + x[at[MISALIGNMENT_Y]] ** 2
        let_in_spin = p[excess, excess] * tilt * abs(wheel.view.carrier) ** 2
        r[first] += off * float(by_roll @ within @ by_roll) + let_in_spin
        r[second] += off * float(by_yaw @ within @ by_yaw) + let_in_spin

    def _push(
        self, states: tuple[list[float], Array], rows: tuple[Array, ...], wheel: Wheel, index: int
    ) -> ForwardResidual:
        """What the forward row of a wheel says; the yaw rate, free in each window, counts as known."""
        (x, p), (h, z, r) = states, rows
        row = self._forward_rows[index]
        by = h[row].take(self._felt[index])
        common = float(by.dot(p.take(self._felt_together[index])).dot(by))
        gain = wheel.geometry.radius * wheel.view.axle_rate_change
        return ForwardResidual(z.item(row), r.item(row), gain, common, x[self._slope], x[self._yaw_rate])

    def _silent(self, index: int, wheel: Wheel, window: Window) -> list[int]:
        """The rows of a wheel that say nothing in this window; its angle does not matter to how it rolls."""
        return [
            self._rows.row_of(measurement, index)
            for measurement in self._rows.measurements
            if (not wheel.angle_initialised and measurement not in BETWEEN_WHEELS)
            or not wheel.is_used
            or window.missing >= MAX_MISSING_SHARE
            or not measurement.usable(window)
            or (measurement in BETWEEN_WHEELS and not wheel.speed_trusted)
            or (measurement in VALID_WHEN_ROLLING and wheel.is_slipping)
        ]


def _clipped(window: Window) -> bool:
    return window.spin_clipped + window.across_clipped + window.force_clipped + window.axial_clipped > 0.0


def _whitening(s: Array) -> Array:
    """Inverse of the lower Cholesky factor of the innovation covariance.

    It makes each innovation, given those before it, a number of sigma 1. (Solving with the factor instead
    wakes the threads of BLAS, a hundred times slower.)
    """
    factor, _ = dpotrf(s, lower=1, clean=1)
    inverse: Array
    inverse, _ = dtrtri(factor, lower=1, overwrite_c=1)
    return inverse
