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


def slice_samples(t: Array, rows: Array, begin: float, end: float) -> WindowSamples:
    """Return the samples between two times, s; rows (6, N): gz, gx, gy, ax, ay, force clipped (0 or 1)."""
    first = max(0, int(np.searchsorted(t, begin, side="right")) - 1)
    last = min(len(t), int(np.searchsorted(t, end, side="left")) + 1)
    t, rows = t[first:last], rows[:, first:last]
    step = np.diff(t)
    left = np.clip((begin - t[:-1]) / step, 0.0, 1.0)
    right = np.clip((end - t[:-1]) / step, 0.0, 1.0)
    towards = 0.5 * (right * right - left * left)
    weight = np.zeros(len(t))
    weight[:-1] += step * (right - left - towards)
    weight[1:] += step * towards
    rate = rows[0]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[:-1] + rate[1:]) * step)])
    angle -= 0.5 * (_angle_at(begin, t, rate, angle) + _angle_at(end, t, rate, angle))
    time = t - 0.5 * (begin + end)
    across, force = rows[1] + 1j * rows[2], rows[3] + 1j * rows[4]
    columns = (weight, time, rate, angle, across, force, rows[5] == 0.0)
    return WindowSamples(*(tuple(column.tolist()) for column in columns))


def _angle_at(time: float, t: Array, rate: Array, angle: Array) -> float:
    place = min(max(int(np.searchsorted(t, time, side="right")) - 1, 0), len(t) - 2)
    step, since = t[place + 1] - t[place], time - t[place]
    return float(angle[place] + since * (rate[place] + 0.5 * since / step * (rate[place + 1] - rate[place])))
