"""Detection of a disturbed magnetic field: a span of a drive whose compass error differs from the rest."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import (
    COMPASS_OFFSET,
    CURVATURE,
    HARD_IRON_FORWARD,
    HARD_IRON_LEFT,
    YAW_RATE,
    YAW_SCALE,
)
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.result import DriveGraph
from hubodo.fuse.graph.solver import Solution

_MAX_BINS = 160
"""Bins of consecutive headings; the search inverts matrices of that size."""
_CORRELATION_TIMES = (3.0, 10.0)
"""s, of the slow errors of a compass: the vehicle tilts as it drives over bumps, and round bends."""
_CORRELATED_SHARES = (0.0, 0.3, 0.6, 0.9)
"""Shares of the variance of one heading that are slow; the rest is white."""
_SIGMA_FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Factors of the scatter of neighbouring headings within which their true sigma is sought."""
_MIN_DISTURBED_BINS = 4
"""Bins of the shortest span; a single outlier is left to the robust loss."""
_SPAN_SIGMAS = np.array([0.3, 0.15, 0.15])
"""Prior 1 sigma of a span's offset, rad, and of its change of hard iron, forward and left."""
_MIN_SPAN_EVIDENCE = 20.0
"""Twice the logarithm of the Bayes factor from which a span is disturbed: it is the best of some thousand."""
_MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
_MIN_SIGMA = 1e-3
"""rad; no compass is steadier."""


@dataclass(frozen=True)
class DisturbedSpan:
    """A span of a drive in which the compass headings are disturbed.

    Attributes
    ----------
    start, end : s, of the first and the last pose in it.
    share : fraction of all headings that lie in the span.
    log_evidence : twice the logarithm of the Bayes factor of a separate offset and iron for the span.
    """

    start: float
    end: float
    share: float
    log_evidence: float


def find_disturbed_span(drive: DriveGraph, solution: Solution, config: GraphConfig) -> DisturbedSpan | None:
    """Return the span whose headings differ most from the rest of the drive; None if there is none.

    A disturbance beside the road rotates the horizontal field by a constant angle and changes its strength,
    in units of which the vehicle's hard iron is stated. So a span gets its own offset and hard iron. Gyro
    drift and constants of the drive together give the deviations a normal distribution. Noise of the compass
    has a white and a slow part; their shares maximise the marginal likelihood, with and without the span.
    """
    factors = drive.graph.find_group(HeadingFactors)
    between = drive.graph.find_group(BetweenFactors)
    if factors is None or between is None:
        return None
    deviation, drift, by_span = compute_deviations(drive, solution, config, factors, between)
    pose_t = drive.odometry.pose_t[factors.pose_index]
    n = len(deviation)
    size = math.ceil(n / _MAX_BINS)
    edges = np.arange(0, n, size)
    if len(edges) < 3 * _MIN_DISTURBED_BINS:
        return None
    counts = np.diff(edges, append=n)
    deviation = np.add.reduceat(deviation, edges) / counts
    drift = np.add.reduceat(np.add.reduceat(drift, edges, axis=0), edges, axis=1) / np.outer(counts, counts)
    by_span = np.add.reduceat(by_span, edges, axis=0) / counts[:, None]
    t = np.add.reduceat(pose_t, edges) / counts
    best_without, best, span = -math.inf, -math.inf, (0, 0)
    spans = _possible_spans(len(edges))
    for noise in _noise_candidates(deviation, t):
        covariance = drift + noise
        inverse = np.linalg.inv(covariance)
        without = -float(deviation @ inverse @ deviation) - float(np.linalg.slogdet(covariance)[1])
        gain, first, last = _best_span(inverse, deviation, by_span, spans)
        best_without = max(best_without, without)
        if without + gain > best:
            best, span = without + gain, (first, last)
    if best - best_without < _MIN_SPAN_EVIDENCE:
        return None
    first, last = int(edges[span[0]]), int(np.append(edges, n)[span[1]]) - 1
    return DisturbedSpan(
        float(pose_t[first]), float(pose_t[last]), (last - first + 1) / n, best - best_without
    )


def compute_deviations(
    drive: DriveGraph,
    solution: Solution,
    config: GraphConfig,
    factors: HeadingFactors,
    between: BetweenFactors,
) -> tuple[Array, Array, Array]:
    """Return the deviation (N,) of headings from those of the gyros, rad, and its covariance without noise.

    The third value holds the derivatives (N, 3) of the deviation by offset and hard iron.

    The factors are linearised at the solution, and both the drift of the gyros and the constants are
    taken back to their prior mean, zero.
    """
    linear = factors.linearise(solution.poses, solution.constants)
    by_heading = linear.pose_jacobian[:, 0, 2] * factors.sigma
    by_constants = linear.constants_jacobian[:, 0] * factors.sigma[:, None]
    totals = np.concatenate([np.zeros((1, 3)), np.cumsum(between.steps.totals, axis=0)])[factors.pose_index]
    start = solution.poses[0, 2] if config.start_heading is None else config.start_heading
    start_error = math.remainder(solution.poses[0, 2] - start, 2.0 * math.pi)
    drift = solution.poses[factors.pose_index, 2] - solution.poses[0, 2] - totals[:, 0] + start_error
    deviation = linear.residual[:, 0] * factors.sigma
    deviation -= by_heading * drift + by_constants @ solution.constants
    by_span = by_constants[:, [COMPASS_OFFSET, HARD_IRON_FORWARD, HARD_IRON_LEFT]].copy()
    by_constants[:, [YAW_SCALE, YAW_RATE, CURVATURE]] += by_heading[:, None] * totals
    variance = np.concatenate([[0.0], np.cumsum(between.steps.covariance[:, 2, 2])])[factors.pose_index]
    start_variance = math.pi**2 / 3.0 if config.start_heading is None else config.start_heading_sigma**2
    walk = np.minimum(variance[:, None], variance) + start_variance
    prior = by_constants * config.constants.to_array()
    return np.asarray(deviation), by_heading[:, None] * walk * by_heading + prior @ prior.T, by_span


def _noise_candidates(deviation: Array, t: Array) -> Iterator[Array]:
    """Yield candidate covariances of the compass noise, rad²: white noise alone, then with a slow part."""
    scatter = _MAD_TO_SIGMA * float(np.median(np.abs(np.diff(deviation)))) / math.sqrt(2.0)
    scatter = max(scatter, _MIN_SIGMA)
    distance = np.abs(t[:, None] - t)
    white = np.eye(len(t))
    for share in _CORRELATED_SHARES:
        for time in _CORRELATION_TIMES if share else _CORRELATION_TIMES[:1]:
            shape = (1.0 - share) * white + share * np.exp(-distance / time)
            # Differences of neighbours show the white part and little of the slow one.
            visible = 1.0 - float(np.mean(shape[np.arange(len(t) - 1), np.arange(1, len(t))]))
            for factor in _SIGMA_FACTORS:
                yield (factor * scatter) ** 2 / max(visible, 0.05) * shape


def _possible_spans(n: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the first bin of each span of n bins, and the bin after it, (M,) each."""
    first, last = np.triu_indices(n + 1, _MIN_DISTURBED_BINS)
    is_part = last - first <= n - _MIN_DISTURBED_BINS
    return first[is_part], last[is_part]


def _best_span(
    inverse: Array, deviation: Array, by_span: Array, spans: tuple[NDArray[Any], NDArray[Any]]
) -> tuple[float, int, int]:
    """Return twice the log of the largest Bayes factor of a span, its first bin, and the bin after it.

    The thousands of small posterior precisions are factorised together, element by element (Cholesky).
    """
    first, last = spans
    n, parameters = by_span.shape
    vector = by_span * (inverse @ deviation)[:, None]
    sums = np.concatenate([np.zeros((1, parameters)), np.cumsum(vector, axis=0)])
    score = (sums[last] - sums[first]).T
    block = np.zeros((n + 1, n + 1))
    factor: dict[tuple[int, int], Array] = {}
    whitened: list[Array] = []
    evidence = np.full(len(first), -2.0 * float(np.log(_SPAN_SIGMAS).sum()))
    for a in range(parameters):
        for b in range(a + 1):
            weighted = by_span[:, a, None] * inverse * by_span[:, b]
            block[1:, 1:] = np.cumsum(np.cumsum(weighted, axis=0), axis=1)
            element = block[last, last] - block[first, last] - block[last, first] + block[first, first]
            for k in range(b):
                element -= factor[a, k] * factor[b, k]
            factor[a, b] = element / factor[b, b] if b < a else np.sqrt(element + _SPAN_SIGMAS[a] ** -2.0)
        whitened.append((score[a] - sum(factor[a, k] * whitened[k] for k in range(a))) / factor[a, a])
        evidence += whitened[a] ** 2 - 2.0 * np.log(factor[a, a])
    best = int(np.argmax(evidence))
    return float(evidence[best]), int(first[best]), int(last[best])
