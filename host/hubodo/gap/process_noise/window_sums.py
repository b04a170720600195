"""Products of the columns, residuals and noise columns of one node, summed per window for the walk filter."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

# Deviations of residuals from their neighbours are limited to the larger of this many sigma and this many
# times the median of their channel.
_MIN_WINSOR_SIGMA, _WINSOR_MEDIANS = 6.0, 8.0
FREE_WALK_VARIANCE = 1e2
# Share of a column's squares that remains in `raw_squares` when a free walk absorbs all of it up to rounding.
_RAW_SQUARES_SHARE = 1e-6
# Numbers of one node processed together, which fit into the processor's cache.
_CHUNK_NUMBERS = 1 << 18


@dataclass(frozen=True)
class RandomWalk:
    """A process noise that is a random walk.

    intensity: unit² per second
    start_variance: variance at the start; from FREE_WALK_VARIANCE on the start is free
    is_white: True for white noise with variance `start_variance` in each window
    correlation_time: s, of a first-order Gauss-Markov process with variance `start_variance`; infinite for a
        random walk
    """

    intensity: float
    start_variance: float = FREE_WALK_VARIANCE
    is_white: bool = False
    correlation_time: float = math.inf

    def decay(self, duration: float) -> float:
        """Return the correlation of values that are `duration` s apart."""
        return 0.0 if self.is_white else math.exp(-duration / self.correlation_time)

    def growth(self, duration: float) -> float:
        """Return the variance that is added within `duration` s."""
        if self.is_white:
            return 0.0
        if math.isinf(self.correlation_time):
            return self.intensity * duration
        return self.start_variance * (1.0 - self.decay(duration) ** 2)


@dataclass(frozen=True)
class Whitening:
    """Whitening of the windows of one segment.

    matrices: (2, 6, M, M), as in `NoiseCorrelation`
    is_standing: (K,), True for windows in which the wheel stands
    """

    matrices: Array
    is_standing: NDArray[np.bool_]

    def apply(self, rows: NDArray[np.float32], windows: slice) -> NDArray[np.float32]:
        """Return rows, (W, M, 6, P+1+C), of some windows, whose noise is white within each."""
        white, is_standing = np.empty_like(rows), self.is_standing[windows]
        for chosen, matrix in zip((~is_standing, is_standing), self.matrices, strict=True):
            white[chosen] = _whiten_rows(rows[chosen], matrix)
        return white


@dataclass(frozen=True)
class NodeSegment:
    """Data of one node in one segment of the log.

    edges: (K+1,) its first sample in each window, and the end
    columns: (P, 6, N) sensitivities
    column_indices: (P,) their positions among all columns
    z: (6, N) residuals in sigma, winsorised
    weight: (6, N), 1/sigma, 0 for excluded samples
    noise_columns: (C, 6, N), change of the channels per unit of each walk that acts on the node
    noise_indices: (C,) positions of these walks
    whitening: None in white noise
    """

    edges: NDArray[np.intp]
    columns: NDArray[np.float32]
    column_indices: Sequence[int]
    z: Array
    weight: Array
    noise_columns: Array
    noise_indices: Sequence[int]
    whitening: Whitening | None = None


@dataclass(frozen=True)
class WindowProducts:
    """Products of one node, summed per window of one segment.

    cross: (K, C, P+1), noise columns times columns and residual
    noise_gram: (K, C, C), noise columns times each other
    shift: (K, free, P), steps of the free walks that were subtracted from the columns
    column_grams: (B, P+1, P+1), products of columns and residual for each `block` windows
    """

    cross: Array
    noise_gram: Array
    shift: Array
    column_grams: Array


class WindowSums:
    """Summed products of one node, segment by segment, in units of the noise.

    noise_indices: (C,) positions of the walks that act on the node
    free_walks: those of these walks whose start is free
    column_indices: (P+1,) positions of its columns and the residual among all
    raw_squares: (P+1,) as in `Innovations`
    channel_squares: (P, 6), squares of the columns in each channel
    """

    def __init__(
        self, segment: NodeSegment, walks: Sequence[RandomWalk], size: int, window: float, block: int
    ) -> None:
        count = len(segment.column_indices) + 1
        self.noise_indices, self.column_indices = (
            np.array(segment.noise_indices, np.intp),
            np.array([*segment.column_indices, size]),
        )
        self.free_walks = [
            k
            for k, place in enumerate(segment.noise_indices)
            if walks[place].start_variance >= FREE_WALK_VARIANCE
        ]
        self.raw_squares, self.channel_squares = np.zeros(count), np.zeros((count - 1, 6))
        self._growth = np.array([walks[segment.noise_indices[k]].intensity * window for k in self.free_walks])
        # Values of the free walks at the end of the last window.
        self._stripped = np.zeros((len(self.free_walks), count - 1))
        self._block, self._begun = block, False

    def add(self, segment: NodeSegment) -> WindowProducts:
        """Return the sums of the next segment."""
        windows, count, n_noises = (
            len(segment.edges) - 1,
            len(segment.column_indices) + 1,
            len(segment.noise_indices),
        )
        cross, noise_gram = np.zeros((windows, n_noises, count)), np.zeros((windows, n_noises, n_noises))
        shift = np.zeros((windows, len(self.free_walks), count - 1))
        column_grams = np.zeros((-(-windows // self._block), count, count))
        for chunk, rows in self._chunks(segment, self._block):
            columns = rows[:, :, : count - 1]
            self.raw_squares[:-1] += _RAW_SQUARES_SHARE * np.einsum("wnk,wnk->k", columns, columns)
            for k, free in enumerate(self.free_walks):
                removed = _remove_free_walk(columns, rows[:, :, count + free], self._stripped[k])
                shift[chunk, k] = np.diff(removed, axis=0, prepend=self._stripped[k : k + 1])
                self._stripped[k] = removed[-1]
            products = rows[:, :, count:].transpose(0, 2, 1) @ rows
            cross[chunk], noise_gram[chunk] = products[:, :, :count], products[:, :, count:]
            for first in range(0, len(rows), self._block):
                part = rows[first : first + self._block].reshape(-1, rows.shape[2])[:, :count]
                column_grams[(chunk.start + first) // self._block] = part.T @ part
                channels = part[:, :-1].reshape(len(part) // 6, 6, count - 1)
                self.channel_squares += np.einsum("ncp,ncp->pc", channels, channels)
        if not self._begun:
            # The first value of a walk with a free start has no prior term.
            shift[0] = 0.0
        self._begun = True
        self.raw_squares += np.einsum("bkk->k", column_grams)
        self.raw_squares[:-1] += (shift**2 / self._growth[:, None]).sum(axis=(0, 1))
        return WindowProducts(cross, noise_gram, shift, column_grams)

    def _chunks(self, segment: NodeSegment, block: int) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Yield some windows at a time with their rows, (W, 6 M, P+1+C), padded with zeros."""
        counts = np.diff(segment.edges)
        windows, longest = len(counts), int(counts.max(initial=1))
        width = len(segment.columns) + 1 + len(segment.noise_indices)
        chunk = block * max(1, _CHUNK_NUMBERS // (6 * longest * width * block))
        for first in range(0, windows, chunk):
            windows_of_chunk = slice(first, min(first + chunk, windows))
            samples = slice(segment.edges[windows_of_chunk.start], segment.edges[windows_of_chunk.stop])
            rows = _stack_rows(segment, samples)
            if (counts[windows_of_chunk] != longest).any():
                is_present = np.arange(longest) < counts[windows_of_chunk, None]
                padded = np.zeros((*is_present.shape, *rows.shape[1:]), np.float32)
                padded[is_present] = rows
                rows = padded
            if segment.whitening is not None:
                rows = segment.whitening.apply(rows.reshape(-1, longest, 6, width), windows_of_chunk)
            yield (
                windows_of_chunk,
                rows.reshape(windows_of_chunk.stop - windows_of_chunk.start, 6 * longest, width),
            )


def _stack_rows(segment: NodeSegment, samples: slice) -> NDArray[np.float32]:
    """Return columns, residual and noise columns of some samples, (n, 6, P+1+C), in units of the noise."""
    weight, count = segment.weight[:, samples], len(segment.columns)
    rows = np.empty((weight.shape[1], 6, count + 1 + len(segment.noise_indices)), np.float32)
    rows[:, :, :count] = (segment.columns[:, :, samples] * weight.astype(np.float32)).T
    rows[:, :, count] = segment.z[:, samples].T
    rows[:, :, count + 1 :] = (segment.noise_columns[:, :, samples] * weight).T
    return rows


def _whiten_rows(rows: NDArray[np.float32], whitening: Array) -> NDArray[np.float32]:
    """Return rows, (W, M, 6, P+1+C), whose noise is white within each window.

    Excluded samples are zero before and after. The whitening is linear, so that residual and columns remain
    consistent where samples are missing.
    """
    length = rows.shape[1]
    is_used = np.asarray(rows.any(axis=3))
    white = whitening[:, :length, :length].astype(np.float32) @ rows.transpose(0, 2, 1, 3)
    return np.asarray(white.transpose(0, 2, 1, 3) * is_used[..., None])


def _remove_free_walk(
    columns: NDArray[np.float32], noise_column: NDArray[np.float32], before: Array
) -> Array:
    """Subtract from the columns, (W, M, P), their projection onto a free walk with column `answer`, (W, M).

    Return that walk in each window, (W, P); without data it keeps its previous value, `before` at first. A
    column may turn the wheel by many turns over a log; subtracting that before forming products avoids
    rounding errors.
    """
    power = np.einsum("wm,wm->w", noise_column, noise_column).astype(float)
    is_observed = power > 0.0
    walk = (noise_column[:, None, :] @ columns)[:, 0].astype(float)
    walk[is_observed] /= power[is_observed, None]
    last = np.maximum.accumulate(np.where(is_observed, np.arange(len(is_observed)), -1))
    walk = np.where(last[:, None] >= 0, walk[last], before)
    columns -= noise_column[:, :, None] * walk[:, None, :].astype(np.float32)
    return walk


def winsorise(z: Array, limits: Array | None = None) -> Array:
    """Limit residuals in sigma, (k, N), so that no single sample dominates.

    limits: (k, 1), as `winsor_limits` gives them for the whole log; None to take those of `z`

    Of a residual beyond the limit, its deviation from the median of five neighbours is limited. A misfit that
    lasts, such as that of a late gyro in a turn, stays as it is: limited, it would not depend on the effect
    that explains it, and a fit would end far from its minimum.
    """
    bound = winsor_limits(z) if limits is None else limits
    rows, samples = np.nonzero(np.abs(z) > bound)
    if not len(rows):
        return z
    window = np.clip(samples[:, None] + np.arange(-2, 3), 0, z.shape[1] - 1)
    neighbours, limit = np.sort(z[rows[:, None], window], axis=1)[:, 2], bound[rows, 0]
    limited = z.copy()
    limited[rows, samples] = neighbours + np.clip(z[rows, samples] - neighbours, -limit, limit)
    return limited


def winsor_limits(z: Array) -> Array:
    """Return the limits of residuals in sigma, (6, 1), of z: (6, N)."""
    return np.array([[_winsor_limit(np.abs(row))] for row in z])


def _winsor_limit(size: Array) -> float:
    # If most residuals are small, the lower bound applies, and the slow median is not needed.
    if 2 * np.count_nonzero(size <= _MIN_WINSOR_SIGMA / _WINSOR_MEDIANS) > len(size):
        return _MIN_WINSOR_SIGMA
    return max(_MIN_WINSOR_SIGMA, _WINSOR_MEDIANS * float(np.median(size)))
