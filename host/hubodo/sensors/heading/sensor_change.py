"""Change of the sensor within a record: one bias does not hold for both parts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError

_BLOCKS, _MIN_BLOCK_SAMPLES = 24, 64
_MIN_SIDE_BLOCKS = 3
"""Blocks on either side of a change during which the sensor moved, as motion changes the noise too."""
_MIN_CHANGE, _MAX_SPREAD = np.log(2.0), np.log(1.15)
"""Change of the noise, and its largest spread (1σ) within a side: the noise of a vehicle varies by more."""


def check_one_sensor(t: Array, rate: Array, spans: Sequence[tuple[int, int]]) -> None:
    """Raise InputError if the noise changes abruptly, as in a record joined from two sensors.

    t, rate: (N,) s and rad/s. spans: standstills, indices; their noise is not compared with that in motion.
    """
    count = len(rate) // _BLOCKS
    if count < _MIN_BLOCK_SAMPLES or not spans:
        return
    is_moving = np.ones(len(rate), bool)
    for i, j in spans:
        is_moving[i:j] = False
    shape = _BLOCKS, count
    differences = np.diff(rate, append=rate[-1:])[: _BLOCKS * count].reshape(shape)
    low, high = np.percentile(differences, (25.0, 75.0), axis=1)
    used = np.flatnonzero(is_moving[: _BLOCKS * count].reshape(shape).all(axis=1) & (high > low))
    levels = np.log((high - low)[used])
    splits = range(_MIN_SIDE_BLOCKS, len(levels) - _MIN_SIDE_BLOCKS + 1)
    if not splits:
        return
    best = min(splits, key=lambda k: _deviation(levels[:k]) + _deviation(levels[k:]))
    before, after = levels[:best], levels[best:]
    change = float(np.median(after) - np.median(before))
    if abs(change) > _MIN_CHANGE and max(_robust_spread(before), _robust_spread(after)) < _MAX_SPREAD:
        at = float(t[int(used[best]) * count])
        raise InputError(
            f"the noise of the gyro changes by a factor of {np.exp(change):.2g} at about {at:.4g} s, as "
            "between two sensors or settings, whose biases differ: use --start or --end for one part, or "
            "mark the standstills of both with --rest"
        )


def _deviation(levels: Array) -> float:
    """Return the sum of absolute deviations from the median."""
    return float(np.abs(levels - np.median(levels)).sum())


def _robust_spread(levels: Array) -> float:
    return 1.4826 * float(np.median(np.abs(levels - np.median(levels))))
