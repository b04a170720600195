"""Segments of a record with a constant rate about the vertical: standstills or steady turns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

_SEGMENT_BLOCK_S = 0.5
_CHANGE_SIGMA = 6.0
"""Sigmas of a change of the mean rate that divides a segment."""
_MIN_SEGMENT_BLOCKS = 2
_MIN_DIVIDED_BLOCKS = 4
"""Shortest part of a divided span; between steady rates there are short transitions."""


@dataclass(frozen=True)
class QuietSegments:
    """K segments with a constant rate.

    Attributes:
        start, end: (K,) index of the first sample and one past the last.
        t: (K,) middle of each, s.
        rate, sigma: (K,) mean rate about the vertical and its sigma from white noise, rad/s.
        slope, slope_sigma: (K,) change of the rate with time and its sigma, rad/s².
    """

    start: NDArray[np.int64]
    end: NDArray[np.int64]
    t: Array
    rate: Array
    sigma: Array
    slope: Array
    slope_sigma: Array

    def __len__(self) -> int:
        return len(self.start)


def divide_quiet_segments(t: Array, rate: Array, spans: list[tuple[int, int]]) -> QuietSegments:
    """Divide quiet spans of samples where the mean rate changes, and return their rates.

    A small step between two steady rates hardly raises the noise of a short window, so a quiet span may hold
    several rates. t: (N,) s. rate: (N,) rad/s.
    """
    step = float(np.median(np.diff(t)))
    width = max(1, round(_SEGMENT_BLOCK_S / step))
    parts = []
    for i, j in spans:
        count = (j - i) // width
        if count < _MIN_SEGMENT_BLOCKS:
            continue
        means = rate[i : i + count * width].reshape(count, width).mean(axis=1)
        noise = _block_noise(means, rate[i:j], width)
        edges = [0, *_find_changes(means, noise), count]
        for a, b in pairwise(edges):
            if b - a >= (_MIN_DIVIDED_BLOCKS if len(edges) > 2 else _MIN_SEGMENT_BLOCKS):
                end = j if b == count else i + b * width
                parts.append((i + a * width, end, *_fit_line(means[a:b], noise, width * step)))
    columns = np.array(parts, np.float64).reshape(-1, 6).T
    starts, ends = columns[:2].astype(np.int64)
    middle = 0.5 * (t[starts] + t[np.maximum(ends - 1, 0)])
    return QuietSegments(starts, ends, middle, *columns[2:])


def _block_noise(means: Array, samples: Array, width: int) -> float:
    """Return the sigma of a block mean, from differences of neighbours or, with few blocks, from samples.

    The scatter is that within blocks, as a span may hold several rates, or that of rounding to steps.
    """
    count = len(samples) // width
    blocks = samples[: count * width].reshape(count, width)
    scatter = np.median(blocks.std(axis=1, ddof=1)) if width > 1 else np.diff(samples).std() / np.sqrt(2.0)
    changes = np.abs(np.diff(samples))
    step = float(np.min(changes, initial=np.inf, where=changes > 0.0))
    rounding = step / np.sqrt(12.0) if np.isfinite(step) else 0.0
    white = max(float(scatter), rounding) / float(np.sqrt(width))
    if len(means) < 8:
        return max(white, 1e-12)
    steps = np.abs(np.diff(means))
    return max(float(np.median(steps) / 0.6745 / np.sqrt(2.0)), 0.3 * white, 1e-12)


def _find_changes(means: Array, noise: float) -> list[int]:
    """Return the indices at which the mean changes, by binary segmentation."""
    changes: list[int] = []
    pending = [(0, len(means))]
    while pending:
        first, last = pending.pop()
        count = last - first
        if count < 2 * _MIN_SEGMENT_BLOCKS:
            continue
        sums = np.cumsum(means[first:last])
        left = np.arange(_MIN_SEGMENT_BLOCKS, count - _MIN_SEGMENT_BLOCKS + 1)
        difference = sums[left - 1] / left - (sums[-1] - sums[left - 1]) / (count - left)
        score = np.abs(difference) / (noise * np.sqrt(1 / left + 1 / (count - left)))
        best = int(score.argmax())
        if score[best] > _CHANGE_SIGMA:
            middle = first + int(left[best])
            changes.append(middle)
            pending += [(first, middle), (middle, last)]
    return sorted(changes)


def _fit_line(means: Array, noise: float, block_s: float) -> tuple[float, float, float, float]:
    """Return mean, its sigma, slope and its sigma; the slope of two blocks or less is unknown."""
    count = len(means)
    sigma = noise / np.sqrt(count)
    if count < 3:
        return float(means.mean()), float(sigma), 0.0, float("inf")
    times = (np.arange(count) - 0.5 * (count - 1)) * block_s
    spread = float(times @ times)
    return float(means.mean()), float(sigma), float(times @ means) / spread, float(noise / np.sqrt(spread))
