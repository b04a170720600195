"""Detection of standstills in which a channel is at the end of its range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.sensors.saturation import saturated_value

_MAX_LEVEL_SHARE = 0.5
"""Share of samples at one value; with noise of one resolution step or more it is at most 0.4."""


def limit_windows(values: Array, width: int, deviation: Array) -> NDArray[np.bool_]:
    """Return (N - width + 1, C) True where all `width` samples equal the channel's largest or smallest value.

    values: (N, C). deviation: standard deviations of the windows. A channel that is constant in other windows
    too has no noise; then its extreme value is a pose like any other, and no window is marked.
    """
    first = values[: len(deviation)]
    at_limit = ((first == values.max(axis=0)) | (first == values.min(axis=0))) & (deviation == 0.0)
    has_noise = np.count_nonzero(deviation == 0.0, axis=0) == np.count_nonzero(at_limit, axis=0)
    return np.asarray(at_limit & has_noise)


def describe_limit(values: Array, part: Array, steps: Array, names: str) -> str:
    """Return why the mean of a standstill is false because of a channel's range, or "".

    values: (N, 3) all samples. part: (K, 3) samples of the standstill. steps: (3,) quantisation steps. names:
    the triad.
    """
    noise = np.diff(values, axis=0)
    for axis in range(values.shape[1]):
        if np.median(np.abs(noise[:, axis])) <= steps[axis]:
            continue
        for limit in (values[:, axis].max(), values[:, axis].min()):
            saturated = saturated_value(part[:, axis])
            share = float(np.mean(part[:, axis] == limit))
            if share > _MAX_LEVEL_SHARE or (saturated is not None and saturated[0] == limit):
                return f"{names} {'xyz'[axis]} is clipped at {limit:.5g}, the end of its range"
    return ""
