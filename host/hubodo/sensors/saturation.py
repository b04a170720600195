"""Detection of a saturated channel: samples that pile up at the largest or smallest value."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError

_MIN_SATURATED_SHARE, _MIN_SATURATED_SAMPLES = 0.005, 10
"""Share and number of samples at the extreme value; fewer move a mean by less than its noise."""
_MIN_PILE_UP_RATIO = 3.0
"""Samples at the extreme over those at the next value: noise has ever fewer towards its tail."""
_MIN_LEVELS = 5
"""Distinct values; a gyro whose noise is below its resolution has one or two, all of them frequent."""


def saturated_value(values: Array) -> tuple[float, float] | None:
    """Return the value at which samples (N,) saturate, and the share of samples equal to it; else None."""
    levels, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    if len(levels) < _MIN_LEVELS:
        return None
    least = max(_MIN_SATURATED_SAMPLES, _MIN_SATURATED_SHARE * len(values))
    for extreme, neighbour in ((-1, -2), (0, 1)):
        if counts[extreme] >= max(least, _MIN_PILE_UP_RATIO * counts[neighbour]):
            return float(levels[extreme]), float(counts[extreme]) / len(values)
    return None


def check_saturation(values: Array, channel: str) -> None:
    """Raise InputError if a stationary channel is saturated, as its mean and noise are then wrong."""
    saturated = saturated_value(values)
    if saturated is not None:
        raise InputError(
            f"{saturated[1]:.0%} of the samples of {channel} equal {saturated[0]:.6g}, an end of its range: "
            "it is saturated, and mean and noise are false; use a larger range, or another part"
        )
