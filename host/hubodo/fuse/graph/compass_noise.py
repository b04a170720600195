"""Level of a compass's noise at low frequency, where its errors do not average out from pose to pose.

A vehicle tilts for seconds at a time, so errors of successive headings are alike. The graph takes them as
independent; their sigma is therefore that of white noise with the same density at low frequency.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from hubodo.arrays import Array
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.disturbed_field import compute_deviations
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.result import DriveGraph
from hubodo.fuse.graph.solver import Solution

_MAX_HEADINGS = 160
"""Headings, or means of several, of which the likelihood is evaluated; each inverts a matrix of that size."""
_SLOW_SHARES = (0.0, 0.3, 0.6, 0.8, 0.95)
_SLOW_TIMES = (2.0, 4.0, 8.0, 16.0)
"""Share of the variance that is slow, and its correlation times, s: bumps, bends, slopes."""
_SCATTER_FACTORS = np.geomspace(0.5, 3.0, 9)
"""Factors of the scatter of the residual within which the sigma of a heading is sought."""


def low_frequency_sigma(
    drive: DriveGraph, solution: Solution, config: GraphConfig, is_used: NDArray[np.bool_]
) -> float:
    """Return the sigma of white noise, rad, with the low-frequency density of the headings' errors.

    The variance is the geometric mean over white and slow parts, correlation times and sizes, weighted by the
    likelihood of the deviations from the gyros' headings, in which drift and constants are marginalised.
    is_used: (N,) False for headings that are left out.
    """
    factors = drive.graph.find_group(HeadingFactors)
    between = drive.graph.find_group(BetweenFactors)
    assert factors is not None and between is not None
    deviation, drift, _ = compute_deviations(drive, solution, config, factors, between)
    residual = factors.linearise(solution.poses, solution.constants).residual[:, 0] * factors.sigma
    deviation, drift, residual = deviation[is_used], drift[np.ix_(is_used, is_used)], residual[is_used]
    t = drive.odometry.pose_t[factors.pose_index][is_used]
    size = math.ceil(len(t) / _MAX_HEADINGS)
    edges = np.arange(0, len(t), size)
    counts = np.diff(edges, append=len(t))
    deviation, residual, t = (np.add.reduceat(it, edges) / counts for it in (deviation, residual, t))
    drift = np.add.reduceat(np.add.reduceat(drift, edges, axis=0), edges, axis=1) / np.outer(counts, counts)
    scatter = max(float(np.sqrt(np.mean(residual**2))), 1e-4)
    likelihoods, variances = [], []
    for shape, correlated_count in _noise_shapes(t):
        for factor in _SCATTER_FACTORS:
            variance = (factor * scatter) ** 2
            try:
                cholesky = cho_factor(drift + variance * shape, lower=True, check_finite=False)
            except LinAlgError:
                continue
            log_det = 2.0 * float(np.log(np.diag(cholesky[0])).sum())
            likelihoods.append(-0.5 * (float(deviation @ cho_solve(cholesky, deviation)) + log_det))
            variances.append(variance * correlated_count)
    weight = np.exp(np.array(likelihoods) - max(likelihoods))
    log_variance = float(weight @ np.log(variances)) / float(weight.sum())
    return math.sqrt(size) * math.exp(0.5 * log_variance)


def _noise_shapes(t: Array) -> Iterator[tuple[Array, float]]:
    """Yield covariances of unit variance, and how many successive headings count as one."""
    distance, white = np.abs(t[:, None] - t), np.eye(len(t))
    step = float(np.median(np.diff(t)))
    for share in _SLOW_SHARES:
        for time in _SLOW_TIMES if share else _SLOW_TIMES[:1]:
            correlation = math.exp(-step / time)
            count = 1.0 - share + share * (1.0 + correlation) / (1.0 - correlation)
            yield (1.0 - share) * white + share * np.exp(-distance / time), count
