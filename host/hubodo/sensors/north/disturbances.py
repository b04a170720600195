"""Detection of blows and bumps during stops of a turntable, by short means that deviate from the rest."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter

from hubodo.arrays import Array

BLOW_WIDTHS_S = (0.1, 0.3, 1.0)
BLOW_SIGMA = 8.0
"""Deviation of a short mean, in its usual deviation, from which it is a blow.

The largest of 10,000 means of white noise deviates by four sigma. A blow that stays below eight sigma for
0.3 s moves the mean of a stop of 20 s by less than its own sigma.
"""
_MARGIN_S = 0.5
_BOUND_SIGMAS = 3.0
"""Sigmas between the estimate and the upper bound of the usual deviation."""
_NEIGHBOURHOOD = 11
"""Means whose median is the level about each mean, so that drift is no blow."""


def find_disturbed_spans(
    channels: Sequence[Array], spans: Sequence[tuple[int, int]], step: float
) -> list[tuple[int, int, int, float]]:
    """Return (index of the span, first sample, one past the last, size in sigmas) of each blow.

    channels: (N,) rates. spans: index ranges [i, j) in which the rate is constant up to drift. step: sample
    interval, s.
    """
    blows: list[tuple[int, int, int, float]] = []
    for channel in channels:
        for width_s in BLOW_WIDTHS_S:
            width = max(1, round(width_s / step))
            deviations = [_deviation_of_means(channel[i:j], width) for i, j in spans]
            usual = _usual_deviation(np.concatenate([*deviations, np.zeros(0)]))
            if usual <= 0.0:
                continue
            margin = round(_MARGIN_S / step)
            for k, ((i, j), deviation) in enumerate(zip(spans, deviations, strict=True)):
                for block in np.flatnonzero(np.abs(deviation) > BLOW_SIGMA * usual).tolist():
                    start, end = i + block * width, i + (block + 1) * width
                    size = float(abs(deviation[block])) / usual
                    blows.append((k, max(i, start - margin), min(j, end + margin), size))
    return _merge(blows)


def _usual_deviation(deviations: Array) -> float:
    """Return an upper bound of the usual deviation of a mean; 0 if there are too few means to tell.

    The median absolute deviation of n normal values has a relative sigma of 1.17 / sqrt(n): few short stops
    would otherwise make a blow of the largest of their means.
    """
    # A mean that is the median of its own neighbourhood shows nothing, nor does the first or the last one.
    sizes = np.abs(deviations[deviations != 0.0])
    if len(sizes) <= 8:
        return 0.0
    return 1.4826 * float(np.median(sizes)) * (1.0 + _BOUND_SIGMAS * 1.17 / math.sqrt(len(sizes)))


def _deviation_of_means(values: Array, width: int) -> Array:
    """Return the deviations of means of `width` samples from the median of their neighbourhood.

    The first and the last mean count as undisturbed, because the table may still settle there.
    """
    count = len(values) // width
    if count < _NEIGHBOURHOOD:
        return np.zeros(0)
    means = values[: count * width].reshape(count, width).mean(axis=1)
    deviations = means - median_filter(means, _NEIGHBOURHOOD, mode="nearest")
    deviations[[0, -1]] = 0.0
    return np.asarray(deviations)


def _merge(blows: list[tuple[int, int, int, float]]) -> list[tuple[int, int, int, float]]:
    """Return the blows in order, with overlapping ones of one span merged."""
    merged: list[tuple[int, int, int, float]] = []
    for k, a, b, size in sorted(blows):
        if merged and merged[-1][0] == k and a <= merged[-1][2]:
            _, first, last, largest = merged[-1]
            merged[-1] = (k, first, max(last, b), max(largest, size))
        else:
            merged.append((k, a, b, size))
    return merged
