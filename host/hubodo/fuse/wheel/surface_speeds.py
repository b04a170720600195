"""Surface speeds of another odometer, averaged over the windows of the wheel filter."""

from __future__ import annotations

import math

import numpy as np

from hubodo.fuse.wheel.window import WINDOW_S
from hubodo.recording import Table
from hubodo.time_gaps import check_time_gaps

_MAX_ROW_GAP_S = 0.5
"""s between rows; the record counts as interrupted over longer gaps. Estimated."""

SurfaceSpeeds = dict[int, tuple[float, float]]
"""Surface speeds of the left and the right wheel, m/s, by window number."""


def average_surface_speeds(table: Table) -> SurfaceSpeeds:
    """Return the mean speeds of a table with columns t, left, right; windows with a gap are left out.

    Raise InputError if time stamps cannot belong to one record.
    """
    t = table.t
    if len(t) < 2:
        return {}
    check_time_gaps(t, "wheels")
    numbers = np.arange(int(np.ceil(t[0] / WINDOW_S)), int(np.floor(t[-1] / WINDOW_S)))
    if not len(numbers):
        return {}
    edges = np.append(numbers, numbers[-1] + 1) * WINDOW_S
    step = np.diff(t)
    gap_time = np.concatenate([[0.0], np.cumsum(np.where(step > _MAX_ROW_GAP_S, step, 0.0))])
    is_complete = np.diff(np.interp(edges, t, gap_time)) == 0.0
    means = []
    for side in ("left", "right"):
        # Integral of the linear interpolation between rows.
        distance = np.concatenate([[0.0], np.cumsum(0.5 * (table[side][1:] + table[side][:-1]) * step)])
        index = np.clip(np.searchsorted(t, edges) - 1, 0, len(step) - 1)
        elapsed = edges - t[index]
        slope = np.diff(table[side]) / step
        edge_distance = distance[index] + elapsed * (table[side][index] + 0.5 * elapsed * slope[index])
        means.append(np.diff(edge_distance) / WINDOW_S)
    rows = zip(
        numbers[is_complete].tolist(),
        means[0][is_complete].tolist(),
        means[1][is_complete].tolist(),
        strict=True,
    )
    return {number: (left, right) for number, left, right in rows}


class SurfaceSpeedAverager:
    """Averages speeds over windows as rows arrive, as `average_surface_speeds` does with a whole table."""

    def __init__(self) -> None:
        self.next_number: int | None = None
        """Number of the window that is open; None before the first row."""
        self._row: tuple[float, float, float] | None = None
        self._distances: list[float] | None = None

    def add(self, t: float, left: float, right: float) -> SurfaceSpeeds:
        """Add a row, s and m/s, later than the previous one; return the windows that it completes."""
        before, self._row = self._row, (t, left, right)
        self.next_number = math.floor(t / WINDOW_S)
        if before is None or t - before[0] > _MAX_ROW_GAP_S:
            # Only a window that the rows cover from its start has a mean.
            self._distances = None
            return {}
        speeds: SurfaceSpeeds = {}
        position = before
        for number in range(math.floor(before[0] / WINDOW_S) + 1, self.next_number + 1):
            share = (number * WINDOW_S - before[0]) / (t - before[0])
            edge = (
                number * WINDOW_S,
                before[1] + share * (left - before[1]),
                before[2] + share * (right - before[2]),
            )
            self._integrate(position, edge)
            if self._distances is not None:
                speeds[number - 1] = self._distances[0] / WINDOW_S, self._distances[1] / WINDOW_S
            self._distances, position = [0.0, 0.0], edge
        self._integrate(position, self._row)
        return speeds

    def _integrate(self, start: tuple[float, float, float], end: tuple[float, float, float]) -> None:
        if self._distances is not None:
            for index in (0, 1):
                self._distances[index] += 0.5 * (start[index + 1] + end[index + 1]) * (end[0] - start[0])
