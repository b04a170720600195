"""Carouseling: a continuously turning table, averaged over sixteenths of a turn."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.averages import Averages, average_spans
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.stops import TableMotion

AVERAGES_PER_TURN = 16
MIN_CAROUSEL_TURNS = 2.0


def average_carousel(record: AxisRecord) -> tuple[Averages, Array, float]:
    """Return averages, the (M,) number of the turn of each, and the duration of the turning, s.

    Raises InputError if table and node have no common time, for too few turns, and if wrapped angles are
    too sparse.
    """
    t, table = record.t, record.table
    angle = table.angle_at(t) + record.mounting_angle
    covered = np.flatnonzero((t >= table.t[0]) & (t <= table.t[-1]))
    if len(covered) < 100:
        raise InputError("table.csv and the node have no time in common; put both on one clock")
    first, last = int(covered[0]), int(covered[-1]) + 1
    turns = float(np.ptp(angle[first:last])) / (2 * np.pi)
    if turns < MIN_CAROUSEL_TURNS:
        raise InputError(f"the table made {turns:.1f} turns; a carousel needs at least 2, better 10")
    _check_row_spacing(table)
    length = float(t[last - 1] - t[first])
    averages = average_spans(t, record.rate, angle, [(first, last)], length / (turns * AVERAGES_PER_TURN))
    centre = np.interp((averages.start + averages.end) / 2, t, angle)
    return averages, np.abs(centre - angle[0]) // (2 * np.pi), length


def fit_each_turn(averages: Averages, turn: Array) -> tuple[Array, Array]:
    """Return C and S of each full turn, rad/s, estimated separately with a bias and a slope."""
    centre = (averages.start + averages.end) / 2
    estimates = []
    for k in range(int(turn.max()) + 1):
        rows = turn == k
        if np.count_nonzero(rows) >= AVERAGES_PER_TURN - 1:
            times = centre[rows]
            columns = np.column_stack(
                [averages.cos[rows], averages.sin[rows], np.ones(len(times)), times - times.mean()]
            )
            estimates.append(np.linalg.lstsq(columns, averages.y[rows], rcond=None)[0][:2])
    components = np.array(estimates).reshape(-1, 2)
    return components[:, 0], components[:, 1]


def _check_row_spacing(table: TableMotion) -> None:
    """Raise InputError if rows of wrapped angles are more than half a turn apart."""
    if len(table.t) < 2 or np.abs(np.diff(table.angle)).max() <= np.pi or np.abs(table.angle).max() > 7:
        return
    if float(np.abs(np.diff(np.unwrap(table.angle))).max()) > np.radians(150):
        raise InputError(
            "table.csv is too sparse to follow its wrapped angle; write a row every 10 degrees or less"
        )
