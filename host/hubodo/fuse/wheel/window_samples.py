"""Samples of a window with a clipped gyro, kept so that its integrals can be recomputed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array


class WindowSamples(NamedTuple):
    """The samples of one window and their neighbours outside it.

    Attributes
    ----------
    weight : s; the sum of weight times value is the integral over the window (trapezoidal rule).
    time : s from the middle of the window.
    rate : rad/s about the axle.
    angle : rad, integral of the rate from the middle of the window in angle.
    across : rad/s, gx + i gy.
    force : m/s², ax + i ay.
    force_in_range : False where ax or ay is saturated.
    """

    weight: tuple[float, ...]
    time: tuple[float, ...]
    rate: tuple[float, ...]
    angle: tuple[float, ...]
    across: tuple[complex, ...]
    force: tuple[complex, ...]
    force_in_range: tuple[bool, ...]


def slice_samples(t: Array, rows: Array, start: float, end: float) -> WindowSamples:
    """Return the samples between two times, s; rows (6, N): gz, gx, gy, ax, ay, force clipped (0 or 1)."""
    first = max(0, int(np.searchsorted(t, start, side="right")) - 1)
    last = min(len(t), int(np.searchsorted(t, end, side="left")) + 1)
    t, rows = t[first:last], rows[:, first:last]
    step = np.diff(t)
    first_share = np.clip((start - t[:-1]) / step, 0.0, 1.0)
    last_share = np.clip((end - t[:-1]) / step, 0.0, 1.0)
    second_weight = 0.5 * (last_share * last_share - first_share * first_share)
    weight = np.zeros(len(t))
    weight[:-1] += step * (last_share - first_share - second_weight)
    weight[1:] += step * second_weight
    rate = rows[0]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[:-1] + rate[1:]) * step)])
    angle -= 0.5 * (_angle_at(start, t, rate, angle) + _angle_at(end, t, rate, angle))
    time = t - 0.5 * (start + end)
    across, force = rows[1] + 1j * rows[2], rows[3] + 1j * rows[4]
    columns = (weight, time, rate, angle, across, force, rows[5] == 0.0)
    return WindowSamples(*(tuple(column.tolist()) for column in columns))


def _angle_at(time: float, t: Array, rate: Array, angle: Array) -> float:
    index = min(max(int(np.searchsorted(t, time, side="right")) - 1, 0), len(t) - 2)
    step, elapsed = t[index + 1] - t[index], time - t[index]
    return float(
        angle[index] + elapsed * (rate[index] + 0.5 * elapsed / step * (rate[index + 1] - rate[index]))
    )
