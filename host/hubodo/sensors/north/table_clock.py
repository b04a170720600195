"""Clock offset between table.csv and the node, from the vertical gyro."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.north.stops import MIN_STOP_CUT_S, TABLE_MOTION_ANGLE, TableMotion, stationary_spans

_BLOCK_S = 0.1
_MAX_LAG_S = 5.0
_MAX_UNEXPLAINED_SHARE = 0.25
"""Largest share of the rotation at stops that may remain when the table's times are corrected."""
_TABLE_RATE_WINDOW_S = 0.5


def table_rate(t: Array, table: TableMotion) -> Array:
    """Return the (N,) turn rate of the table, rad/s, as a mean over half a second about each time."""
    start, end = (np.clip(t + sign * _TABLE_RATE_WINDOW_S / 2, table.t[0], table.t[-1]) for sign in (-1, 1))
    return np.asarray((table.angle_at(end) - table.angle_at(start)) / np.maximum(end - start, 1e-9))


def align_table(t: Array, vertical: Array, table: TableMotion) -> tuple[TableMotion, list[str]]:
    """Return the motion of the table with times of the node's clock, and remarks.

    The times are corrected only if the gyro shows turns at the stops, which the correction explains: a lag
    below the cut at the ends of a stop is harmless, and a table that was moved by hand turns within `moving`.

    t: (N,) s. vertical: (N,) rate about the vertical, rad/s. Raises InputError as `stationary_spans`.
    """
    angle = np.concatenate([[0.0], np.cumsum(vertical[:-1] * np.diff(t))])
    turned = _angle_at_stops(t, angle, table)
    if turned <= TABLE_MOTION_ANGLE:
        return table, []
    lag, sigma = measure_table_lag(t, vertical, table, _coarse_lag(t, angle, table))
    corrected = replace(table, t=table.t - lag)
    if not _angle_at_stops(t, angle, corrected) <= _MAX_UNEXPLAINED_SHARE * turned:
        return table, []
    return corrected, [describe_lag(lag, sigma)]


def describe_lag(lag: float, sigma: float) -> str:
    """Return a remark on a corrected lag of the table behind the node, s."""
    side = "late" if lag > 0 else "early"
    return f"table.csv is {abs(lag):.3f} ± {sigma:.3f} s {side} against the node; corrected"


def _angle_at_stops(t: Array, angle: Array, table: TableMotion) -> float:
    """Return the largest angle by which the vertical gyro turned in a stop, rad; 0 without stops.

    angle: (N,) integral of its rate, rad
    """
    spans = np.array([span[:2] for span in stationary_spans(table)]).reshape(-1, 2)
    start, end = np.clip(spans + MIN_STOP_CUT_S * np.array([1.0, -1.0]), t[0], t[-1]).T
    measured = end - start > 4 * MIN_STOP_CUT_S
    if not measured.any():
        return 0.0
    start, end = start[measured], end[measured]
    turned = np.interp(end, t, angle) - np.interp(start, t, angle)
    bias = np.median(turned / (end - start))
    return float(np.abs(turned - bias * (end - start)).max())


def _coarse_lag(t: Array, angle: Array, table: TableMotion) -> float:
    """Return the lag of the table, s, at which its rate correlates best with that of the vertical gyro.

    angle: (N,) integral of the rate of the gyro, rad
    """
    steps = round(_MAX_LAG_S / _BLOCK_S)
    edges = np.arange(t[0], t[-1], _BLOCK_S)
    extended = np.arange(-steps, len(edges) + steps) * _BLOCK_S + t[0]
    measured = np.diff(np.interp(edges, t, angle))
    rate = np.diff(table.angle_at(extended))
    correlation = np.correlate(rate, measured - measured.mean(), "valid")
    return float((int(correlation.argmax()) - steps) * _BLOCK_S)


def measure_table_lag(
    t: Array, vertical: Array, table: TableMotion, start: float = 0.0
) -> tuple[float, float]:
    """Return the lag of table.csv relative to the node and its sigma, s; infinite if it is not observable.

    The rate that the vertical gyro measures minus that of the table is, to first order,
    bias + scale error * rate + lag * (change of the rate), so a turn that begins or ends shows the lag.

    t: (N,) s. vertical: (N,) rate about the vertical, rad/s. start: initial value of the lag, s.
    """
    block = max(1, round(_BLOCK_S / float(np.median(np.diff(t)))))
    count = len(t) // block
    if count < 20:
        return 0.0, float("inf")
    edges = t[: count * block : block]
    measured = vertical[: count * block].reshape(count, block).mean(axis=1)[:-1]
    lag = start
    sigma = float("inf")
    for _ in range(4):
        rate = np.diff(table.angle_at(edges + lag)) / np.diff(edges)
        change = (_rate_between(edges, table, lag + 0.05) - _rate_between(edges, table, lag - 0.05)) / 0.1
        design = np.column_stack([np.ones(count - 1), rate, change])
        power = float(change @ change)
        if power < 1e-12 or np.linalg.matrix_rank(design) < 3:
            return 0.0, float("inf")
        coefficients = np.linalg.lstsq(design, measured, rcond=None)[0]
        residual = measured - design @ coefficients
        covariance = np.linalg.inv(design.T @ design) * float(residual @ residual) / max(1, count - 4)
        step = float(coefficients[2] / max(coefficients[1], 0.1))
        sigma = float(np.sqrt(covariance[2, 2]))
        lag += float(np.clip(step, -0.3, 0.3))
        if abs(step) < 1e-3:
            break
    return lag, sigma


def _rate_between(edges: Array, table: TableMotion, lag: float) -> Array:
    return np.asarray(np.diff(table.angle_at(edges + lag)) / np.diff(edges))
