"""Accelerations beyond the range of an IMU, from a second accelerometer on the same node.

The second chip (an ADXL375: 200 g, with a scale uncertain by 10 % and offsets of up to some g) is calibrated
against the IMU while no axis of the IMU is saturated:

    c = f + D f + o + n

c and f are the specific forces as measured by the chip and the IMU, D the scale and alignment errors of the
chip, o its offset, n its noise. The IMU's noise is a hundredth of n, so it is the regressor. D and o are the
recursive least-squares estimate up to the start of the present second, with a prior from the data sheet. A
saturated axis of the IMU gets its component of (1 + D)^-1 (c - o).

All decisions follow from the times of measurement, so the result is independent of how samples are split into
blocks, as long as the chip's samples arrive within `MAX_DELAY`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.ranges import HIGH_G_NOISE_DENSITY
from hubodo.fuse.wheel.preintegration import BEYOND_RANGE
from hubodo.recording import Table

MAX_DELAY = 0.3
"""s by which samples of the chip may arrive later than those of the IMU: at 100 Hz a message of 16 samples is
0.16 s old. Samples within that time after an outage of the chip are not used, see `_MAX_SILENCE`."""

_MAX_SILENCE = 1.0
"""s without samples of the chip, after which samples of the IMU no longer wait for them."""

_MAX_STEP = 0.025
"""s between two samples of the chip; longer is a gap. Its slowest rate is 100 Hz."""

_CELL_S = 1.0
"""s; the calibration changes at whole seconds."""

_MEMORY_CELLS = 600.0
"""Cells of memory: a rim that warms by 20 K in 10 minutes moves the offset by 0.2 g (data sheet, 10 mg/K)."""

_NOISE = HIGH_G_NOISE_DENSITY * np.sqrt(200.0)
"""m/s², 1 sigma of a sample at 200 Hz of bandwidth (data sheet)."""

_PRIOR_SIGMAS = np.array([0.05, 0.05, 0.05, STANDARD_GRAVITY])
"""1 sigma of an element of D (data sheet: a scale of 44.1 to 53.9 mg per step; a tilt of 3 degrees), and of
the offset, m/s² (data sheet: 0.4 g typically)."""

_MAX_SIGMA = 0.5
"""m/s², 1 sigma of the calibration's error in a sample beyond which the sample stays saturated."""

_CHIP_LIMIT = 0.995 * 200.0 * STANDARD_GRAVITY
"""m/s², from which on the chip itself is saturated."""

_SINGULAR_VALUES = (0.5, 2.0)
"""Bounds of the singular values of 1 + D; a chip beyond them is damaged, and not used."""


class RangeExtension:
    """Replacement of saturated values of one node's accelerometer.

    Parameters
    ----------
    limit
        m/s² from which on the IMU's accelerometer counts as saturated.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._imu_t, self._imu = np.empty(0), np.empty((0, 3))
        self._chip_t, self._chip = np.empty(0), np.empty((0, 3))
        self._first_usable = np.inf
        self._newest_chip = -np.inf
        self._next_cell: int | None = None
        self._normal, self._right = np.zeros((4, 4)), np.zeros((4, 3))
        self._estimate: tuple[Array, Array, Array] | None = None
        self._estimate_is_current = False

    def add_chip(self, t: Array, accel: Array) -> None:
        """Add samples of the second accelerometer: t (N,) s, increasing; accel (N, 3) m/s²."""
        fresh = t > self._newest_chip
        t, accel = t[fresh], accel[fresh]
        if not len(t):
            return
        step = np.diff(t, prepend=self._newest_chip)
        starts = np.where(step > _MAX_SILENCE, t + MAX_DELAY, -np.inf)
        starts[0] = max(starts[0], -np.inf if step[0] > _MAX_SILENCE else self._first_usable)
        first_usable = np.maximum.accumulate(starts)
        self._first_usable, self._newest_chip = float(first_usable[-1]), float(t[-1])
        usable = t >= first_usable
        self._chip_t = np.concatenate([self._chip_t, t[usable]])
        self._chip = np.concatenate([self._chip, accel[usable]])

    def add_imu(self, t: Array, accel: Array) -> None:
        """Add samples of the IMU for the calibration: t (N,) s, increasing; accel (N, 3) m/s²."""
        self._imu_t, self._imu = np.concatenate([self._imu_t, t]), np.concatenate([self._imu, accel])

    def is_awaited(self, t: Array, accel: Array, newest: float) -> bool:
        """Return True if samples of the chip that a block of the IMU needs are due to arrive.

        newest: s, time of the newest sample of the IMU.
        """
        saturated = t[(np.abs(accel) >= self._limit).any(axis=1)]
        if not len(saturated) or newest - self._newest_chip > _MAX_SILENCE:
            return False
        return bool(saturated[-1] >= self._newest_chip and newest - saturated[-1] < MAX_DELAY)

    def extend(self, t: Array, accel: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return accelerations (N, 3), m/s², and which samples (N,) contain values of the chip.

        Blocks are passed in the order of time. All saturated axes of a sample are replaced, or none.
        """
        saturated = np.abs(accel) >= self._limit
        replaced = np.zeros(len(t), np.bool_)
        rows = np.flatnonzero(saturated.any(axis=1))
        if not len(rows):
            return accel, replaced
        accel = accel.copy()
        cells = np.floor(t[rows] / _CELL_S).astype(np.int64)
        for cell in np.unique(cells).tolist():
            self._learn_until(cell)
            chosen = rows[cells == cell]
            force, is_known = self._calibrated_force(t[chosen])
            chosen, force = chosen[is_known], force[is_known]
            accel[chosen] = np.where(saturated[chosen], force, accel[chosen])
            replaced[chosen] = True
        return accel, replaced

    def learn(self) -> None:
        """Calibrate with the seconds that are complete, and forget their samples."""
        if not len(self._imu_t):
            return
        if not len(self._chip_t):
            first = int(np.searchsorted(self._imu_t, self._imu_t[-1] - _CELL_S))
            self._imu_t, self._imu = self._imu_t[first:].copy(), self._imu[first:].copy()
        self._learn_until(int(np.floor((self._imu_t[-1] - MAX_DELAY) / _CELL_S)))

    def _learn_until(self, cell: int) -> None:
        """Calibrate with the seconds before `cell`."""
        if self._next_cell is None:
            if not len(self._chip_t):
                return
            self._next_cell = int(np.floor(self._chip_t[0] / _CELL_S))
        while self._next_cell < cell:
            self._learn_cell(self._next_cell)
            self._next_cell += 1
        start = self._next_cell * _CELL_S
        first = int(np.searchsorted(self._imu_t, start))
        if first > len(self._imu_t) // 2:
            self._imu_t, self._imu = self._imu_t[first:].copy(), self._imu[first:].copy()
        first = int(np.searchsorted(self._chip_t, start - MAX_DELAY))
        if first > len(self._chip_t) // 2:
            self._chip_t, self._chip = self._chip_t[first:].copy(), self._chip[first:].copy()

    def _learn_cell(self, cell: int) -> None:
        first, end = np.searchsorted(self._imu_t, [cell * _CELL_S, (cell + 1) * _CELL_S])
        fading = np.exp(-1.0 / _MEMORY_CELLS)
        self._normal, self._right = fading * self._normal, fading * self._right
        self._estimate_is_current = False
        if first == end:
            return
        imu = self._imu[first:end]
        chip, is_known = self._interpolate(self._imu_t[first:end])
        is_known &= (np.abs(imu) < self._limit).all(axis=1)
        imu, chip = imu[is_known], chip[is_known]
        regressors = np.column_stack([imu, np.ones(len(imu))])
        # einsum sums in a fixed order, products of matrices do not.
        self._normal = self._normal + np.einsum("ni,nj->ij", regressors, regressors)
        self._right = self._right + np.einsum("ni,nj->ij", regressors, chip - imu)

    def _interpolate(self, t: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the chip's samples (N, 3) at times (N,), and where it has samples around them."""
        if len(self._chip_t) < 2:
            return np.zeros((len(t), 3)), np.zeros(len(t), np.bool_)
        right = np.searchsorted(self._chip_t, t, side="right")
        inside = (right > 0) & (right < len(self._chip_t))
        right = np.clip(right, 1, len(self._chip_t) - 1)
        before, after = self._chip_t[right - 1], self._chip_t[right]
        first, second = self._chip[right - 1], self._chip[right]
        share = (t - before) / (after - before)
        in_range = np.maximum(np.abs(first), np.abs(second)).max(axis=1) < _CHIP_LIMIT
        interpolated = first + share[:, None] * (second - first)
        return interpolated, inside & in_range & (after - before <= _MAX_STEP)

    def _calibrated_force(self, t: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return specific forces (N, 3) by the calibrated chip, and where they are known well enough."""
        chip, is_known = self._interpolate(t)
        estimate = self._current_estimate()
        if estimate is None:
            return chip, np.zeros(len(t), np.bool_)
        inverse, offset, covariance = estimate
        chip = chip - offset
        # Sums of products in a fixed order, so that a sample alone and in a block have the same bits.
        force = np.column_stack([sum(row[i] * chip[:, i] for i in range(3)) for row in inverse])
        terms = [*force.T, np.ones(len(t))]
        variance = sum(covariance[i, j] * terms[i] * terms[j] for i in range(4) for j in range(4))
        return force, is_known & (variance <= _MAX_SIGMA**2)

    def _current_estimate(self) -> tuple[Array, Array, Array] | None:
        """Return (1 + D)^-1, o and the covariance (4, 4) of each row of D and o; None if not plausible."""
        if not self._estimate_is_current:
            information = self._normal / _NOISE**2 + np.diag(_PRIOR_SIGMAS**-2)
            covariance = np.linalg.inv(information)
            errors = covariance @ self._right / _NOISE**2
            matrix = np.eye(3) + errors[:3].T
            singular = np.linalg.svd(matrix, compute_uv=False)
            plausible = _SINGULAR_VALUES[0] < singular[-1] and singular[0] < _SINGULAR_VALUES[1]
            self._estimate = (np.linalg.inv(matrix), errors[3], covariance) if plausible else None
            self._estimate_is_current = True
        return self._estimate


def extend_table(table: Table, chip: Table, limit: float) -> Table:
    """Return a node's table with the values of the second accelerometer, and a column `BEYOND_RANGE`.

    limit: m/s² from which on the IMU's accelerometer counts as saturated.
    """
    extension = RangeExtension(limit)
    extension.add_chip(chip.t, chip.accel)
    extension.add_imu(table.t, table.accel)
    accel, replaced = extension.extend(table.t, table.accel)
    if not replaced.any():
        return table
    columns = dict(zip(("ax", "ay", "az"), accel.T, strict=True))
    return Table({**table.columns, **columns, BEYOND_RANGE: replaced.astype(np.float64)}, table.t_ns)
