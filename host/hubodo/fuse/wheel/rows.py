"""Where each number of the measurements stands in one Jacobian over all wheels; nobody writes a column."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel import measurements
from hubodo.fuse.wheel.entries import Columns
from hubodo.fuse.wheel.measurements import Measurement


class Rows:
    """Jacobian, residuals and their variances of all wheels, filled at once from one list of floats.

    The list holds, wheel by wheel, the derivatives of all measurements in the order of their STATES, then
    the residuals, then the variances. measurements: all of them, in that order.
    """

    def __init__(self, columns: Columns) -> None:
        self._wheels, self._of_each = len(columns.wheels), measurements.OF_EACH_WHEEL
        self.measurements = self._of_each + measurements.BETWEEN_WHEELS
        self.count, self.size = self._wheels * len(self.measurements), columns.size
        places: list[int] = []
        jacobian = self.count * self.size
        for wheel in range(self._wheels):
            rows = self.of_wheel(wheel)
            for row, measurement in zip(rows, self.measurements, strict=True):
                places += [row * self.size + column for column in columns.of(wheel, measurement.STATES)]
            places += [jacobian + row for row in rows]
            places += [jacobian + self.count + row for row in rows]
        self._places = np.array(places)
        self._table = np.zeros(jacobian + 2 * self.count)
        self._jacobian = self._table[:jacobian].reshape(self.count, self.size)
        self._residuals, self._variances = self._table[jacobian : -self.count], self._table[-self.count :]
        # Takes a list of floats into an array in half the time that numpy does.
        self._packing = f"{len(places)}d"
        self._values = np.empty(len(places))

    def of(self, measurement: Measurement, wheel: int) -> int:
        """The row of a measurement of a wheel: those between wheels come behind those of each wheel."""
        place, each = self.measurements.index(measurement), len(self._of_each)
        return each * wheel + place if place < each else place * self._wheels + wheel

    def of_wheel(self, wheel: int) -> list[int]:
        """All rows of a wheel."""
        return [self.of(measurement, wheel) for measurement in self.measurements]

    def fill(self, values: list[float]) -> tuple[Array, Array, Array]:
        """Jacobian (rows, states), residuals (rows,) and variances (rows,) of a window of each wheel.

        They are good until the next one is filled in.
        """
        struct.pack_into(self._packing, self._values.data, 0, *values)
        self._table[self._places] = self._values
        return self._jacobian, self._residuals, self._variances

    def __deepcopy__(self, memo: Any) -> Rows:
        # Nothing in it outlives a window: copies of a filter may share it.
        return self
