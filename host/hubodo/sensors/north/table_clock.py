"""Clock offset between table.csv and the node, from the vertical gyro."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.north.stops import TableMotion

_BLOCK_S = 0.1
_TABLE_RATE_WINDOW_S = 0.5


def table_rate(t: Array, table: TableMotion) -> Array:
    """Return the (N,) turn rate of the table, rad/s, as a mean over half a second about each time."""
    start, end = (np.clip(t + sign * _TABLE_RATE_WINDOW_S / 2, table.t[0], table.t[-1]) for sign in (-1, 1))
    return np.asarray((table.angle_at(end) - table.angle_at(start)) / np.maximum(end - start, 1e-9))


def measure_table_lag(t: Array, vertical: Array, table: TableMotion) -> tuple[float, float]:
    """Return the lag of table.csv relative to the node and its sigma, s; infinite if it is not observable.

    The rate that the vertical gyro measures minus that of the table is, to first order,
    bias + scale error * rate + lag * (change of the rate), so a turn that begins or ends shows the lag.

    t: (N,) s. vertical: (N,) rate about the vertical, rad/s.
    """
    block = max(1, round(_BLOCK_S / float(np.median(np.diff(t)))))
    count = len(t) // block
    if count < 20:
        return 0.0, float("inf")
    edges = t[: count * block : block]
    measured = vertical[: count * block].reshape(count, block).mean(axis=1)[:-1]
    lag = 0.0
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
