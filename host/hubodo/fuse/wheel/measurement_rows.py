"""Layout of the measurements of all wheels in one Jacobian, and the rows that a window does not use."""

from __future__ import annotations

import struct

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel import measurements
from hubodo.fuse.wheel.entries import StateLayout
from hubodo.fuse.wheel.measurements import Measurement
from hubodo.fuse.wheel.wheel import WheelMode, usage_by_mode
from hubodo.fuse.wheel.window import Window


class MeasurementRows:
    """Jacobian, residuals and variances of all wheels, filled from one flat list of floats.

    The list holds, wheel by wheel, the derivatives of all measurements in the order of their STATES, then
    the residuals, then the variances. `measurements` is the tuple of all measurement modules in that order.
    """

    def __init__(self, columns: StateLayout) -> None:
        self._wheels, self._of_each = len(columns.wheels), measurements.PER_WHEEL
        self.measurements = self._of_each + measurements.BETWEEN_WHEELS
        self._used_by_mode = usage_by_mode(self.measurements)
        self.count, self.size = self._wheels * len(self.measurements), columns.size
        places: list[int] = []
        jacobian = self.count * self.size
        for wheel in range(self._wheels):
            rows = self.rows_of_wheel(wheel)
            for row, measurement in zip(rows, self.measurements, strict=True):
                places += [
                    row * self.size + column for column in columns.columns_of(wheel, measurement.STATES)
                ]
            places += [jacobian + row for row in rows]
            places += [jacobian + self.count + row for row in rows]
        self._places = np.array(places)
        self._table = np.zeros(jacobian + 2 * self.count)
        self._jacobian = self._table[:jacobian].reshape(self.count, self.size)
        self._residuals, self._variances = self._table[jacobian : -self.count], self._table[-self.count :]
        # `struct` copies a list of floats into an array in half the time of numpy.
        self._pack = struct.Struct(f"{len(places)}d").pack_into
        self._values = np.empty(len(places))
        self._buffer = self._values.data

    def row_of(self, measurement: Measurement, wheel: int) -> int:
        """Return the row of a measurement of a wheel.

        Rows that compare wheels come after those of single wheels.
        """
        place, each = self.measurements.index(measurement), len(self._of_each)
        return each * wheel + place if place < each else place * self._wheels + wheel

    def rows_of_wheel(self, wheel: int) -> list[int]:
        """Return all rows of a wheel."""
        return [self.row_of(measurement, wheel) for measurement in self.measurements]

    def unused_rows(self, wheel: int, mode: WheelMode, window: Window) -> list[int]:
        """Return the rows of a wheel, by its index, that are not used in this window."""
        return [
            self.row_of(measurement, wheel)
            for measurement, is_used in zip(self.measurements, self._used_by_mode[mode], strict=True)
            if not is_used or not measurement.is_usable(window)
        ]

    def fill(self, values: list[float]) -> tuple[Array, Array, Array]:
        """Return Jacobian (rows, states), residuals (rows,) and variances (rows,) of a window.

        The arrays hold all wheels; they are overwritten by the next call.
        """
        self._pack(self._buffer, 0, *values)
        self._table[self._places] = self._values
        return self._jacobian, self._residuals, self._variances
