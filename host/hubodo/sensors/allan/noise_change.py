"""Change of the white noise within a record: a record of two sensors, settings or data rates."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.even_grid import EvenGrid

_N_LEVELS = 16
_MIN_CHANGE = 1.25
"""Ratio of the noise of both parts from which on one number does not describe both."""
_MIN_CHANGE_SIGMA = 8.0
_MIN_LEVEL_SAMPLES = 64


def find_noise_change(record: EvenGrid) -> tuple[float, float, float] | None:
    """Return time (s of the log), and scatter of neighbouring samples before and after, or None.

    The scatter is that of differences of neighbours, by their quartiles, so that kicks do not count.
    """
    levels = _block_levels(record)
    if levels is None:
        return None
    logs, sigma = levels
    scores = [_score(logs[:split], logs[split:], sigma) for split in range(2, len(logs) - 1)]
    split = 2 + int(np.argmax(scores))
    if max(scores) < _MIN_CHANGE_SIGMA:
        return None
    at = record.start + split * record.duration / len(logs)
    return at, float(np.exp(logs[:split].mean())), float(np.exp(logs[split:].mean()))


def _score(before: Array, after: Array, sigma: float) -> float:
    """Return the change of the level in its standard errors; 0 for one that is too small to matter."""
    change = abs(float(after.mean() - before.mean()))
    parts = [max(sigma, float(part.std())) / np.sqrt(len(part)) for part in (before, after)]
    return change / float(np.hypot(*parts)) if change > np.log(_MIN_CHANGE) else 0.0


def _block_levels(record: EvenGrid) -> tuple[Array, float] | None:
    """Return the log scatter of each block, (16,), and its standard error; None for a short record."""
    count = len(record.values) // _N_LEVELS
    if count < _MIN_LEVEL_SAMPLES:
        return None
    logs = []
    for k in range(_N_LEVELS):
        part = slice(k * count, (k + 1) * count)
        values, present = record.values[part], record.present[part]
        differences = np.diff(values)[present[1:] & present[:-1]]
        if len(differences) < _MIN_LEVEL_SAMPLES // 2:
            return None
        low, high = np.percentile(differences, (25.0, 75.0))
        if high <= low:
            return None
        logs.append(np.log((high - low) / 1.349 / np.sqrt(2.0)))
    return np.array(logs), 1.6 / np.sqrt(count)
