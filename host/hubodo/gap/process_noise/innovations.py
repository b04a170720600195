"""Innovations of residuals and sensitivity columns, with process noise filtered out window by window.

The angle of a wheel is a random walk about the integrated inputs; so may be a gyro's bias or a clock. Each
walk has one value per window. A Kalman filter propagates them for the residual and for all columns together.
Its innovations are independent from window to window, so their quadratic forms add up (Kailath 1968).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dgesv

from hubodo.arrays import Array
from hubodo.gap.process_noise.symmetric import SymmetricStack
from hubodo.gap.process_noise.window_sums import (
    FREE_WALK_VARIANCE,
    NodeSegment,
    RandomWalk,
    WindowProducts,
    WindowSums,
)


@dataclass(frozen=True)
class Innovations:
    """Sums of products of the innovations of residual and columns.

    grams: (P+1, P+1) for each block of windows; the last row and column belong to the residual
    log_determinant: ln det of the innovation covariance; -½ (last element + log_determinant) is the
        log-likelihood
    raw_squares: (P+1,) squares of the columns before the bounded walks were filtered out, with the squares of
        the free walks' steps
    channel_squares: (P, C) squares of the columns in each channel, six channels per node
    smoothed: (K, C) smoothed walks relative to their tracked values; empty unless requested
    """

    grams: SymmetricStack
    log_determinant: float
    raw_squares: Array
    channel_squares: Array
    smoothed: Array


@dataclass(frozen=True)
class _FilterStep:
    """Predicted and updated walks of one window: means, (C,), and covariances, (C, C)."""

    expected: Array
    expected_covariance: Array
    mean: Array
    covariance: Array


def filter_innovations(
    segments: Iterable[Iterable[NodeSegment]],
    walks: Sequence[RandomWalk],
    tracked: Array,
    n_columns: int,
    window: float,
    block: int,
    smooth: bool = False,
    step_covariance: Array | float = 0.0,
) -> Innovations:
    """Filter the walks out of residuals and columns and return the innovations.

    segments: for each segment of time an iterable of the nodes' data; whole blocks except in the last. A
        segment is requested after the previous one was summed, so that only one is in memory
    tracked: (C, K) values of the walks about which residual and columns were computed
    n_columns: P, columns in total
    window: s
    block: windows per gram
    smooth: True to return `smoothed`
    step_covariance: (C, C) covariance per second between the steps of different walks, zero on the diagonal
    """
    window_sums: list[WindowSums] = []
    tracked_steps = np.diff(tracked, axis=1, prepend=0.0)
    start = np.array([walk.start_variance for walk in walks])
    tracked_steps[:, 0] = np.where(start >= FREE_WALK_VARIANCE, 0.0, tracked[:, 0])
    walk_filter, first = _WalkFilter(walks, n_columns, window, smooth, step_covariance), 0
    grams = SymmetricStack.allocate(-(-tracked.shape[1] // block), n_columns + 1)
    for shares in segments:
        summed = []
        for k, share in enumerate(shares):
            if k == len(window_sums):
                window_sums.append(WindowSums(share, walks, n_columns, window, block))
            summed.append((window_sums[k], window_sums[k].add(share)))
            del share
        windows = len(summed[0][1].cross)
        grams_of_segment = _segment_grams(
            walk_filter, summed, tracked_steps[:, first : first + windows], block, n_columns + 1
        )
        grams.store(first // block, grams_of_segment)
        first += windows
    raw_squares, channel_squares = np.zeros(n_columns + 1), np.zeros((n_columns, 6 * len(window_sums)))
    for k, node in enumerate(window_sums):
        raw_squares[node.column_indices] += node.raw_squares
        channel_squares[node.column_indices[:-1], 6 * k : 6 * k + 6] += node.channel_squares
    decay = np.array([walk.decay(window) for walk in walks])
    mean = _smooth(walk_filter.steps, decay, len(walks))
    return Innovations(grams, walk_filter.log_determinant, raw_squares, channel_squares, mean)


def _segment_grams(
    walk_filter: _WalkFilter,
    summed: Sequence[tuple[WindowSums, WindowProducts]],
    tracked_steps: Array,
    block: int,
    size: int,
) -> Array:
    """Return the grams, (B, P+1, P+1), of one segment.

    tracked_steps: (C, K), steps of the tracked values
    size: P+1
    """
    count, windows = tracked_steps.shape
    grams = np.zeros((-(-windows // block), size, size))
    shift, cross = np.zeros((2, windows, count, size))
    noise_gram = np.zeros((windows, count, count))
    for node, sums in summed:
        indices = node.noise_indices[:, None]
        shift[:, node.noise_indices[node.free_walks][:, None], node.column_indices[:-1]] += sums.shift
        cross[:, indices, node.column_indices] += sums.cross
        noise_gram[:, indices, node.noise_indices] += sums.noise_gram
        grams[:, node.column_indices[:, None], node.column_indices] += sums.column_grams
    # The residual was computed about the tracked value, so steps of that value count as steps of the walk.
    shift[:, :, -1] += tracked_steps.T
    return grams - walk_filter.update(cross, noise_gram, shift, block)


class _WalkFilter:
    """Kalman filter of the walks, (C, P+1), for all columns and the residual together."""

    def __init__(
        self,
        walks: Sequence[RandomWalk],
        size: int,
        window: float,
        smooth: bool,
        step_covariance: Array | float,
    ) -> None:
        is_white = np.array([walk.is_white for walk in walks], bool)
        start, count = np.array([walk.start_variance for walk in walks]), len(walks)
        self._growth = np.diag([walk.growth(window) for walk in walks]) + np.multiply(step_covariance, window)
        self._white_variance = np.diag(np.where(is_white, start, 0.0))
        self._transition = np.array([walk.decay(window) for walk in walks])[:, None]
        self._decay = self._transition * self._transition.T
        self._estimate, self._variance = np.zeros((count, size + 1)), np.diag(start)
        self._smooth, self._is_started = smooth, False
        self.log_determinant, self.steps = 0.0, list[_FilterStep]()

    def update(self, cross: Array, noise_gram: Array, shift: Array, block: int) -> Array:
        """Return the share of the walks, (B, P+1, P+1), in the products of each `block` windows.

        cross: (K, C, P+1), noise_gram: (K, C, C), shift: (K, C, P+1), as in `WindowProducts`, for all nodes
            together
        """
        identity = np.eye(len(self._variance))
        left, right = np.empty((2, len(cross), 2, *self._estimate.shape))
        right[:, 0] = cross
        spreads = np.empty_like(noise_gram)
        after, variance = self._estimate, self._variance
        windows = zip(cross, noise_gram, shift, spreads, left, right, strict=True)
        for cross_product, g, step, spread, (predicted, u), (_, to) in windows:
            np.subtract(after, step, out=predicted)
            predicted *= self._transition
            if self._is_started:
                variance = variance * self._decay + self._growth + self._white_variance
            self._is_started = True
            np.subtract(cross_product, g @ predicted, out=u)
            np.add(identity, variance @ g, out=spread)
            gain = _solve(spread, variance)
            after = np.add(predicted, gain @ u, out=to)
            if self._smooth:
                self.steps.append(_FilterStep(predicted[:, -1].copy(), variance, after[:, -1].copy(), gain))
            variance = gain
        self._estimate, self._variance = after.copy(), variance
        self.log_determinant += float(np.linalg.slogdet(spreads)[1].sum())
        # x' m + m' x - x' G x + u' A u with u = m - G x; x: prediction, A: updated covariance.
        size, grams = self._estimate.shape[1], []
        for first in range(0, len(cross), block):
            product = left[first : first + block].reshape(-1, size).T @ right[first : first + block].reshape(
                -1, size
            )
            grams.append(0.5 * (product + product.T))
        return np.array(grams)


def _solve(matrix: Array, right_side: Array) -> Array:
    """Solve matrix · x = right like `np.linalg.solve`, four times faster for matrices as small as these."""
    if not len(matrix):
        return right_side
    _, _, solution, info = dgesv(matrix, right_side)
    if info:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(solution)


def _smooth(steps: Sequence[_FilterStep], decay: Array, count: int) -> Array:
    """Return the smoothed walks, (K, C), by Rauch, Tung and Striebel's smoother (1965)."""
    means = np.empty((len(steps), count))
    for k in range(len(steps) - 1, -1, -1):
        means[k] = steps[k].mean
        if k + 1 < len(steps):
            later = steps[k + 1]
            scale = np.sqrt(later.expected_covariance.diagonal())
            correction = (means[k + 1] - later.expected) / scale
            correction = _solve(later.expected_covariance / (scale[:, None] * scale), correction) / scale
            means[k] += steps[k].covariance @ (decay * correction)
    return means
