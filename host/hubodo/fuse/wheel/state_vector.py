"""States and covariance of the wheel filter: positions and single rows worked in, values read out."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel import mounting_check
from hubodo.fuse.wheel.entries import Entry
from hubodo.fuse.wheel.measurements import Row, position
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.records import Innovation
from hubodo.fuse.wheel.state import InitialState


class StateVector:
    """x: list of the states, in the order of `columns`. p: their covariance. wheels: the book of each."""

    def __init__(self, begin: InitialState) -> None:
        self.x, self.p, self.wheels = begin.x, begin.p, begin.wheels
        self.columns, self._at = begin.columns, begin.columns.vehicle

    def estimate(self, node: str | None, entry: Entry) -> Quantity:
        """Value and 1 sigma of an entry.

        Of the vehicle (node None) or of a node and its wheel, facing left.
        """
        at = self._at if node is None else next(wheel.columns for wheel in self.wheels if wheel.name == node)
        place = at[entry]
        return Quantity(self.x[place], math.sqrt(max(0.0, self.p[place, place])))

    def position_innovation(self, told: Position) -> Innovation:
        """What a position at the end of the last window would say that is new."""
        rows = position.measure(self.x, self._at, told)
        z = np.array([row[0] for row in rows])
        h = np.array([self.derivatives(row, self._at) for row in rows])
        ph = self.p @ h.T
        s = h @ ph + np.diag([row[1] for row in rows])
        return Innovation(z, s, ph, float(z @ np.linalg.solve(s, z)))

    def derivatives(self, row: Row, at: Mapping[Entry, int]) -> Array:
        """A row of the Jacobian, (n,)."""
        h = np.zeros(len(self.x))
        for entry, value in row[2].items():
            h[at[entry]] = value
        return h

    def update_with_row(self, row: Row, at: Mapping[Entry, int]) -> None:
        """One row alone; one that stands out has the weight of one that just does not."""
        residual, variance, _ = row
        h = self.derivatives(row, at)
        ph = self.p @ h
        s = max(float(h @ ph) + variance, residual**2 / mounting_check.GATE_SIGMA**2)
        self.apply_correction(ph * (residual / s), np.outer(ph, ph / s))

    def apply_correction(self, change: Array, drop: Array) -> None:
        """The states by a change, the covariance less what that took of it."""
        self.x = [a + b for a, b in zip(self.x, change.tolist(), strict=True)]
        self.p -= drop
