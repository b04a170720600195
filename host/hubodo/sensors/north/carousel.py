"""A table that turns without a stop, cut into averages of a sixteenth of a turn."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.averages import Averages, average
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.stops import TableMotion

PER_TURN = 16
MIN_TURNS = 2.0


def carousel_averages(record: AxisRecord) -> tuple[Averages, Array, float]:
    """Averages, (M,) number of the turn of each, and s in which the table turned.

    Raises InputError: no time in common, too few turns, wrapped angles in rows too far apart.
    """
    t, table = record.t, record.table
    angle = table.angle_at(t) + record.mounting
    inside = np.flatnonzero((t >= table.t[0]) & (t <= table.t[-1]))
    if len(inside) < 100:
        raise InputError("table.csv and the node have no time in common; put both on one clock")
    first, last = int(inside[0]), int(inside[-1]) + 1
    turns = float(np.ptp(angle[first:last])) / (2 * np.pi)
    if turns < MIN_TURNS:
        raise InputError(f"the table made {turns:.1f} turns; a carousel needs 2 at least, better 10")
    _check_rows(table)
    length = float(t[last - 1] - t[first])
    made = average(t, record.rate, angle, [(first, last)], length / (turns * PER_TURN))
    middle = np.interp((made.start + made.end) / 2, t, angle)
    return made, np.abs(middle - angle[0]) // (2 * np.pi), length


def per_turn(averages: Averages, turn: Array) -> tuple[Array, Array]:
    """C and S of each full turn by itself, rad/s, with a bias and a slope of its own."""
    middle = (averages.start + averages.end) / 2
    found = []
    for k in range(int(turn.max()) + 1):
        rows = turn == k
        if np.count_nonzero(rows) >= PER_TURN - 1:
            m = middle[rows]
            columns = np.column_stack([averages.cos[rows], averages.sin[rows], np.ones(len(m)), m - m.mean()])
            found.append(np.linalg.lstsq(columns, averages.y[rows], rcond=None)[0][:2])
    made = np.array(found).reshape(-1, 2)
    return made[:, 0], made[:, 1]


def _check_rows(table: TableMotion) -> None:
    """Wrapped angles are joined by the nearest way, which needs rows at less than half a turn."""
    if len(table.t) < 2 or np.abs(np.diff(table.angle)).max() <= np.pi or np.abs(table.angle).max() > 7:
        return
    if float(np.abs(np.diff(np.unwrap(table.angle))).max()) > np.radians(150):
        raise InputError(
            "table.csv is too sparse to follow its wrapped angle; write a row every 10 degrees or less"
        )
