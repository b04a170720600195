"""Carouseling: a continuously turning table, averaged over sixteenths of a turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array, find_runs
from hubodo.errors import InputError
from hubodo.sensors.north.averages import Averages, average_spans
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.disturbances import find_disturbed_spans
from hubodo.sensors.north.stops import TableMotion
from hubodo.sensors.north.table_clock import describe_lag, measure_table_lag, table_rate

AVERAGES_PER_TURN = 16
MIN_CAROUSEL_TURNS = 2.0
_MIN_SPAN_TURNS = 1.0
"""A shorter span of steady turning is not used, because its bias cannot be separated from Earth rate."""
_STEADY_SHARE = 0.2
"""Largest deviation of the turn rate from its median, relative to it, of a steadily turning table."""
_EDGE_CUT_S = 0.5
"""Time cut where steady turning begins and ends."""
_TYPICAL_LAG_S = 0.1
"""Typical error of two clocks that were set by hand or over a network."""
_CROSS_AXIS_SIGMA = 4.0
"""Sigmas of the cross-axis coefficient from which it is corrected."""


@dataclass(frozen=True)
class CarouselTurns:
    """The steady turning of one record.

    Attributes:
        averages: averages of each span of steady turning.
        turn: (M,) number of the turn of each average, per span.
        duration: total time of steady turning, s.
        notes: one line each.
    """

    averages: tuple[Averages, ...]
    turn: tuple[Array, ...]
    duration: float
    notes: tuple[str, ...]


def average_carousel(record: AxisRecord) -> CarouselTurns:
    """Return the averages over the spans in which the table turned steadily.

    Each span has a bias of its own: the contribution of the table's rotation (by misalignment and cross-axis
    sensitivity) is constant only within a span, and differs from that at standstill. Raises InputError if
    table and node have no common time, for too few turns, and if wrapped angles are too sparse.
    """
    t, table = record.t, record.table
    covered = (t >= table.t[0]) & (t <= table.t[-1])
    if np.count_nonzero(covered) < 100:
        raise InputError("table.csv and the node have no time in common; put both on one clock")
    turns = float(np.ptp(table.angle_at(t[covered]))) / (2 * np.pi)
    if turns < MIN_CAROUSEL_TURNS:
        raise InputError(f"the table made {turns:.1f} turns; a carousel needs at least 2, better 10")
    _check_row_spacing(table)
    lag, notes = _correct_lag(record, covered)
    angle = table.angle_at(t + lag) + record.mounting_angle
    spin = table_rate(t + lag, table)
    rate = record.rate - _cross_axis_rate(record, covered, angle, spin)
    spans = _steady_spans(t, spin, covered, table.moving_at(t + lag))
    disturbed = find_disturbed_spans([rate], spans, float(np.median(np.diff(t))))
    notes += [
        f"{t[a]:.1f}..{t[b - 1]:.1f} s is excluded: a blow or a bump, {size:.0f} times the usual noise"
        for _, a, b, size in disturbed
    ]
    parts, part_turns, duration = [], [], 0.0
    for k, (i, j) in enumerate(spans):
        span_turns = float(np.ptp(angle[i:j])) / (2 * np.pi)
        if span_turns < _MIN_SPAN_TURNS:
            continue
        pieces = _remove_disturbed((i, j), [(a, b) for row, a, b, _ in disturbed if row == k])
        length = float(t[j - 1] - t[i])
        averages = average_spans(t, rate, angle, pieces, length / (span_turns * AVERAGES_PER_TURN))
        centre = np.interp((averages.start + averages.end) / 2, t, angle)
        parts.append(averages)
        part_turns.append(np.abs(centre - angle[i]) // (2 * np.pi))
        duration += length
    if not parts:
        raise InputError(
            "the table never turned steadily for a whole turn; turn it at a constant rate, several turns at "
            "least"
        )
    return CarouselTurns(tuple(parts), tuple(part_turns), duration, tuple(notes))


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


def _correct_lag(record: AxisRecord, covered: NDArray[np.bool_]) -> tuple[float, list[str]]:
    """Return the lag of table.csv behind the node, s, and remarks; 0 if the vertical gyro shows no lag."""
    if record.vertical_rate is None:
        return 0.0, []
    t = record.t[covered]
    lag, sigma = measure_table_lag(t, record.vertical_rate[covered], record.table)
    fastest = float(np.abs(table_rate(t, record.table)).max())
    if sigma > _TYPICAL_LAG_S:
        return 0.0, [
            f"if the clock of table.csv is off by {_TYPICAL_LAG_S:g} s, the azimuth is off by "
            f"{np.degrees(fastest * _TYPICAL_LAG_S):.1f} degrees, which steady turning cannot show: let the "
            "table stand for some seconds before and after the turning"
        ]
    if abs(lag) < 4 * sigma:
        return 0.0, []
    return lag, [describe_lag(lag, sigma)]


def _cross_axis_rate(record: AxisRecord, covered: NDArray[np.bool_], angle: Array, spin: Array) -> Array:
    """Return the (N,) varying part of the rate that the axis measures of the table's rotation, rad/s.

    A cross-axis sensitivity of 1 % at 20 deg/s is 70 times the Earth's rate; it changes with the turn rate.
    It is zero if the turn rate does not vary enough to determine the sensitivity.
    """
    t = record.t
    rows = np.flatnonzero(covered)
    block = max(1, round(0.2 / float(np.median(np.diff(t)))))
    count = len(rows) // block
    rows = rows[: count * block]

    def block_means(values: Array) -> Array:
        return np.asarray(values[rows].reshape(count, block).mean(axis=1))

    times = block_means(t)
    design = np.column_stack(
        [
            np.ones(count),
            times - times.mean(),
            block_means(np.cos(angle)),
            block_means(np.sin(angle)),
            block_means(spin),
        ]
    )
    scale = np.linalg.norm(design, axis=0)
    if not scale.all() or np.linalg.cond(design / scale) > 1e6:
        return np.zeros(len(t))
    y = block_means(record.rate)
    coefficients = np.linalg.lstsq(design, y, rcond=None)[0]
    residual = y - design @ coefficients
    covariance = np.linalg.inv(design.T @ design) * float(residual @ residual) / max(1, count - 5)
    share = float(coefficients[-1])
    if abs(share) < _CROSS_AXIS_SIGMA * float(np.sqrt(covariance[-1, -1])):
        return np.zeros(len(t))
    return np.asarray(share * (spin - np.median(spin[covered])))


def _steady_spans(
    t: Array, spin: Array, covered: NDArray[np.bool_], moving: NDArray[np.bool_]
) -> list[tuple[int, int]]:
    """Return the index ranges in which the table turned at its usual rate in one direction."""
    usual = float(np.median(np.abs(spin[covered & moving]))) if (covered & moving).any() else 0.0
    step = float(np.median(np.diff(t)))
    spans = []
    for direction in (1.0, -1.0):
        steady = covered & moving & (np.abs(direction * spin - usual) <= _STEADY_SHARE * usual)
        spans += find_runs(steady)
    cut = round(_EDGE_CUT_S / step)
    last = len(t)
    trimmed = [(i + cut if i else i, j - cut if j < last else j) for i, j in sorted(spans)]
    return [(i, j) for i, j in trimmed if j - i > 4 * cut]


def _remove_disturbed(span: tuple[int, int], disturbed: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the span without the disturbed index ranges."""
    parts, start = [], span[0]
    for a, b in sorted(disturbed):
        if a > start:
            parts.append((start, a))
        start = max(start, b)
    return [*parts, (start, span[1])] if span[1] > start else parts


def _check_row_spacing(table: TableMotion) -> None:
    """Raise InputError if rows of wrapped angles are more than half a turn apart."""
    if len(table.t) < 2 or np.abs(np.diff(table.angle)).max() <= np.pi or np.abs(table.angle).max() > 7:
        return
    if float(np.abs(np.diff(np.unwrap(table.angle))).max()) > np.radians(150):
        raise InputError(
            "table.csv is too sparse to follow its wrapped angle; write a row every 10 degrees or less"
        )
