"""Alignment of the clocks of two sensors of the same motion: an offset and a skew between them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from hubodo.arrays import Array

# s, windows over which samples are averaged: the first finds delays of seconds, the second milliseconds.
_WINDOWS = (4.0, 0.5)
# Averages per window to which delays are fitted.
_AVERAGES_PER_WINDOW = 5
_MAX_ITERATIONS, _MIN_SAMPLES = 8, 10
# s, change of the delay below which it has converged, far less than a period of the motion.
_CONVERGED_DELAY = 1e-4


def align_times(t: Array, value: Array, other_t: Array, other: Array, disturbance: Array) -> Array:
    """Return the times of the samples of another sensor on the clock of the first, (M,) s.

    The delay between two clocks is linear in time; it is fitted by Gauss-Newton to the slow motion that both
    sensors measure. If it does not bring them closer together, the times are returned as they are.

    t, value: (N,) s and samples of the first sensor
    other_t, other: (M,) s and samples of the other sensor, up to a factor
    disturbance: (N,) differs between the sensors by an unknown factor, such as the yaw rate for two wheels
    """
    if min(len(t), len(other_t)) < _MIN_SAMPLES:
        return other_t
    middle, half = 0.5 * (t[0] + t[-1]), 0.5 * (t[-1] - t[0])
    delay = np.zeros(2)
    for window in _WINDOWS:
        first, second, turning = (
            uniform_filter1d(samples, max(round(window / float(np.median(np.diff(times)))), 1))
            for times, samples in ((t, value), (other_t, other), (t, disturbance))
        )
        at = np.arange(t[0], t[-1], window / _AVERAGES_PER_WINDOW)
        first, turning = np.interp(at, t, first), np.interp(at, t, turning)
        slope, drift = np.gradient(second, other_t), (at - middle) / half
        start, misfit_at_start = delay, np.inf
        for iteration in range(_MAX_ITERATIONS):
            delayed = at + delay[0] + delay[1] * drift
            delayed_value, speed = np.interp(delayed, other_t, second), np.interp(delayed, other_t, slope)
            columns = np.stack([speed, speed * drift, delayed_value, turning, np.ones_like(at)], axis=1)
            columns_without_delay = columns[:, 2:]
            misfit = _misfit(columns_without_delay, first)
            if iteration == 0:
                misfit_at_start = misfit
            solution = np.linalg.lstsq(columns, first, rcond=None)[0]
            step = solution[:2] / solution[2] if solution[2] else np.zeros(2)
            if np.abs(step).max() < _CONVERGED_DELAY:
                break
            delay = np.clip(delay + step, -0.5 * half, 0.5 * half)
        if misfit > misfit_at_start:
            delay = start
    # A sample of the other sensor with the stamp s was taken at the time t with t + delay(t) = s.
    return np.asarray(middle + (other_t - middle - delay[0]) / (1.0 + delay[1] / half))


def _misfit(columns: Array, value: Array) -> float:
    """Return the squares of what the columns, (N, K), leave of a value, (N,)."""
    residual = value - columns @ np.linalg.lstsq(columns, value, rcond=None)[0]
    return float(residual @ residual)
