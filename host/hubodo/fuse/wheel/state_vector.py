"""State vector and covariance of the wheel filter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.corrections import Correction, ExternalCorrection, StateReset, WindowCorrection
from hubodo.fuse.wheel.entries import Entry
from hubodo.fuse.wheel.history import History
from hubodo.fuse.wheel.initial_state import InitialState
from hubodo.fuse.wheel.measurements import Row, position
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.mounting_check import GATE_SIGMA


class Innovation(NamedTuple):
    """Innovation of a position.

    Attributes
    ----------
    z : (2,) m, measured minus expected position.
    s : (2, 2) m², its covariance.
    ph : (n, 2), covariance of the states with the expected position.
    nis : normalised innovation squared, z' s^-1 z.
    """

    z: Array
    s: Array
    ph: Array
    nis: float

    @property
    def cost(self) -> float:
        """Return -2 log likelihood, up to a constant."""
        return self.nis + float(np.linalg.slogdet(self.s)[1])


class StateVector:
    """States with their covariance, and the history of their steps.

    Attributes
    ----------
    x : list of the states, in the order of `columns`.
    p : their covariance (n, n).
    wheels : the wheels.
    history : records of the newest steps.
    """

    def __init__(self, initial: InitialState, history: History) -> None:
        self.x, self.p, self.wheels = initial.x, initial.p, initial.wheels
        self.columns, self._at = initial.columns, initial.columns.vehicle
        self.history = history
        self._reset_columns: list[int] = []

    def estimate(self, node: str | None, entry: Entry) -> Quantity:
        """Return value and 1 sigma of an entry.

        node: None for an entry of the vehicle, else the node's name; the sign is that of a node facing left.
        """
        columns = self._at if node is None else next(it.columns for it in self.wheels if it.name == node)
        column = columns[entry]
        return Quantity(self.x[column], math.sqrt(max(0.0, self.p[column, column])))

    def apply(self, change: Correction | StateReset) -> None:
        """Apply a correction, or register a reset; set a barrier if a replay would not reproduce it."""
        if isinstance(change, StateReset):
            self._reset_columns += change.columns
        else:
            self.x = [a + b for a, b in zip(self.x, change.change.tolist(), strict=True)]
            self.p -= change.reduction
        if not change.is_replayable:
            self.history.set_barrier()

    def position_innovation(self, measured: Position) -> Innovation:
        """Return the innovation of a position at the end of the last window."""
        rows = position.measure(self.x, self._at, measured)
        z = np.array([row[0] for row in rows])
        h = np.array([self.derivatives(row, self._at) for row in rows])
        ph = self.p @ h.T
        s = h @ ph + np.diag([row[1] for row in rows])
        return Innovation(z, s, ph, float(z @ np.linalg.solve(s, z)))

    def update_with_position(self, innovation: Innovation) -> None:
        """Update the state with a position."""
        weight = np.linalg.solve(innovation.s, innovation.ph.T)
        self.apply(ExternalCorrection(innovation.z @ weight, innovation.ph @ weight))

    def derivatives(self, row: Row, columns: Mapping[Entry, int]) -> Array:
        """Return a row of the Jacobian, (n,)."""
        h = np.zeros(len(self.x))
        for entry, value in row[2].items():
            h[columns[entry]] = value
        return h

    def update_with_row(
        self, row: Row, columns: Mapping[Entry, int], kind: type[Correction] = WindowCorrection
    ) -> None:
        """Update the state with a single row; an outlier gets the weight of one at the gate."""
        residual, variance, _ = row
        h = self.derivatives(row, columns)
        ph = self.p @ h
        s = max(float(h @ ph) + variance, residual**2 / GATE_SIGMA**2)
        self.apply(kind(ph * (residual / s), np.outer(ph, ph / s)))

    def inflate(self, variances: Mapping[Entry, float]) -> None:
        """Add variances to entries of the vehicle, from outside the windows."""
        reduction = np.zeros_like(self.p)
        for entry, variance in variances.items():
            reduction[self._at[entry], self._at[entry]] = -variance
        self.apply(ExternalCorrection(np.zeros(len(self.x)), reduction))
