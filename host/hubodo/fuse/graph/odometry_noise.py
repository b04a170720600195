"""Variance components of the odometry's noise, estimated from the GNSS fixes of a solved graph.

About a solution the problem is linear: the offset of the fixes from the odometry is the sum of the noise of
all earlier segments of odometry, of the fixes' own noise, and of start and constants, which are integrated
out (restricted maximum likelihood, Patterson and Thompson 1971). Errors of fixes that are correlated in time,
as those of real receivers, are components too; otherwise they would be attributed to the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from hubodo.arrays import Array
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.factor import LinearisedFactors
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.review import MIN_USED_WEIGHT
from hubodo.fuse.graph.solver import Solution

if TYPE_CHECKING:
    from scipy.optimize import OptimizeResult

IndexArray = NDArray[np.intp]

_MIN_FIXES_PER_SECTION = 30
"""Fixes; fewer determine no noise."""

_MAX_BLOCKS_PER_SECTION, _SECTION_DURATION, _MAX_SECTIONS = 60, 600.0, 4
"""Blocks of averaged fixes in a section of a drive, duration of a section in s, and number of sections.

A block lasts ten seconds at most, in which an odometry hardly drifts; the cost grows with the third power of
the number of blocks.
"""

_FIX_ERROR_TIMES = (15.0, 150.0)
"""s, correlation times of fix errors: multipath from what one passes, and a changing sky. Estimated."""

_CORRELATED_ERROR_RATIO = 0.05
"""Expected size of correlated fix errors as a fraction of a fix's sigma."""

_LOG_VARIANCE_SIGMA = np.array([1.4, 1.4, 2.0, 0.3, 3.0, 3.0])
"""Prior 1 sigma of the natural logarithm of each variance component.

Noise of the odometry along and across, known to a factor of two, and in heading, to a factor of three; the
fixes' white noise, which they declare and their scatter confirms; their correlated noise, two terms.
Estimated.
"""

_START_LOG_VARIANCES = np.array(
    [
        *([0.0] * 6, [3.0, 3.0, 0.0, 0.0, 0.0, 0.0]),
        *([0.0, 0.0, 3.0, 0.0, 0.0, 0.0], [0.0, 0.0, 6.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 5.0, 5.0]),
    ]
)
"""Log variances from which the search starts: where a noise is small the likelihood has no gradient by it."""

_LOG_VARIANCE_BOUNDS = [(-6.0, 4.0), (-6.0, 4.0), (-6.0, 8.0), *[(-6.0, 9.0)] * 3]
"""Minimum and maximum of the log variances.

Odometry that drifts by more than a foot per metre is not odometry: the fixes jumped. Estimated.
"""

_NOISE_COST_TOLERANCE = 1e-5
"""Fraction of the cost, which is some hundreds; a smaller gain changes no sigma."""

_MODE_SEPARATION = 1.0
"""Difference of log variances below which two optima are the same."""

_MIN_LOG_POSTERIOR_GAIN = 2.0
"""Gain in log posterior from which less noise than expected is accepted: two sigma."""

_START_POSE_SIGMA = np.array([30.0, 30.0, 0.5])
"""m, m, rad; prior 1 sigma of the first pose about the solution, larger than that of any solution."""


@dataclass(frozen=True, eq=False)
class _SectionModel:
    """Linear Gaussian model of the fixes in one section of a drive.

    Attributes
    ----------
    y : (n,) m, averaged fixes minus the odometry without noise, east before north.
    start_covariance : (n, n) m², effect of the start and the constants.
    unit_covariances : (6, n, n), covariance of each component for a variance of one, ordered as
        _LOG_VARIANCE_SIGMA.
    """

    y: Array
    start_covariance: Array
    unit_covariances: Array


def estimate_noise_factors(graph: FactorGraph, solution: Solution, pose_t: Array, constants: Array) -> Array:
    """Return the factors on the odometry's sigmas along, across and in heading, (3,).

    constants: (N_CONSTANTS,) prior 1 sigma of the constants. Returns ones where there are too few fixes.
    """
    between, positions = graph.find_group(BetweenFactors), graph.find_group(PositionFactors)
    if between is None or positions is None:
        return np.ones(3)
    fixes = positions.linearise(solution.poses, solution.constants)
    used_fixes = np.flatnonzero(positions.loss.weight(fixes.squared_norms) > MIN_USED_WEIGHT)
    if len(used_fixes) < _MIN_FIXES_PER_SECTION:
        return np.ones(3)
    odometry_rows = between.linearise(solution.poses, solution.constants)
    sigma = positions.sigma
    sections = [
        _model_section(indices, fixes, sigma, odometry_rows, between, solution, pose_t, constants)
        for indices in _choose_sections(used_fixes, pose_t[fixes.pose_index])
    ]
    return np.exp(0.5 * _average_modes(sections)[:3])


def _choose_sections(used_fixes: IndexArray, t: Array) -> list[IndexArray]:
    """Return the indices of the fixes of each section, evenly spaced over the drive."""
    duration = float(t[used_fixes[-1]] - t[used_fixes[0]])
    count = int(np.ceil(duration / _SECTION_DURATION))
    starts = t[used_fixes[0]] + duration / count * np.arange(count)
    if count > _MAX_SECTIONS:
        starts = starts[np.linspace(0, count - 1, _MAX_SECTIONS).astype(np.intp)]
    edges = np.searchsorted(t[used_fixes], np.column_stack([starts, starts + duration / count + 1e-9]))
    return [
        used_fixes[first:last] for first, last in edges.tolist() if last - first >= _MIN_FIXES_PER_SECTION
    ]


def _model_section(
    indices: IndexArray,
    fixes: LinearisedFactors,
    sigma: Array,
    odometry_rows: LinearisedFactors,
    between: BetweenFactors,
    solution: Solution,
    pose_t: Array,
    constants: Array,
) -> _SectionModel:
    """Return the model of one section, linearised at a solution.

    A noise (n_f, n_l, n_h) of segment k (forward, left, heading) moves each later pose i by dp_i = e^(i h_k)
    (n_f + i n_l) + i (p_i - p_(k+1)) n_h, with p and h position (complex) and heading of the poses.
    """
    state = fixes.pose_index[indices]
    first, last = int(state[0]), int(state[-1])
    fix_sigma = sigma[indices]
    averaging, block_variance = _block_weights(len(indices), fix_sigma)
    position = solution.poses[first : last + 1, 0] + 1j * solution.poses[first : last + 1, 1]
    pose_weights = np.zeros((len(averaging), last - first + 1))
    np.add.at(pose_weights.T, state - first, averaging.T)
    later_weights, later_positions = (
        _reverse_cumsum(pose_weights)[:, 1:],
        _reverse_cumsum(pose_weights * position)[:, 1:],
    )
    forward = np.exp(1j * solution.poses[first:last, 2])
    by_heading = 1j * (later_positions - later_weights * position[1:])
    by_noise = np.stack([later_weights * forward, 1j * later_weights * forward, by_heading])

    segments = slice(first, last)
    unwhitened = np.linalg.inv(between.whitening[segments])
    residual = (unwhitened @ odometry_rows.residual[segments, :, None])[:, :, 0]
    by_constants = unwhitened @ odometry_rows.constants_jacobian[segments]
    fix_offset = -fixes.residual[indices] * fix_sigma[:, None]
    by_delay = (fixes.constants_jacobian[indices] * fix_sigma[:, None, None]).transpose(1, 0, 2)
    by_all_constants = averaging @ (by_delay[0] + 1j * by_delay[1]) - np.einsum(
        "abk,kac->bc", by_noise, by_constants
    )
    y = averaging @ (fix_offset[:, 0] + 1j * fix_offset[:, 1]) + np.einsum("abk,ka->b", by_noise, residual)
    y = y + by_all_constants @ solution.constants
    by_start = np.stack(
        [np.ones(len(y)), 1j * np.ones(len(y)), 1j * (pose_weights @ position - position[0])], axis=1
    )
    start_effect = _stack_components(np.hstack([by_all_constants * constants, by_start * _START_POSE_SIGMA]))
    by_components = by_noise * np.sqrt(np.einsum("kii->ik", between.steps.covariance[segments]))[:, None]
    t = averaging @ pose_t[state]
    time_difference = np.abs(t[:, None] - t)
    correlated_variance = (_CORRELATED_ERROR_RATIO * float(np.median(fix_sigma))) ** 2
    unit_covariances = np.empty((len(_LOG_VARIANCE_SIGMA), 2 * len(averaging), 2 * len(averaging)))
    for covariance, by_component in zip(unit_covariances, by_components, strict=False):
        covariance[:] = _stack_components(by_component) @ _stack_components(by_component).T
    unit_covariances[len(by_components)] = np.diag(np.tile(block_variance, 2))
    for covariance, correlation_time in zip(
        unit_covariances[len(by_components) + 1 :], _FIX_ERROR_TIMES, strict=True
    ):
        covariance[:] = correlated_variance * np.kron(np.eye(2), np.exp(-time_difference / correlation_time))
    return _SectionModel(_stack_components(y[:, None])[:, 0], start_effect @ start_effect.T, unit_covariances)


def _block_weights(count: int, sigma: Array) -> tuple[Array, Array]:
    """Return weights (blocks, count) that average successive fixes, and the variance of each average."""
    blocks = min(_MAX_BLOCKS_PER_SECTION, count)
    edges = np.linspace(0, count, blocks + 1).astype(np.intp)
    weights = np.zeros((blocks, count))
    weights[np.repeat(np.arange(blocks), np.diff(edges)), np.arange(count)] = sigma**-2.0
    weight_sums = weights.sum(axis=1)
    return weights / weight_sums[:, None], 1.0 / weight_sums


def _reverse_cumsum(rows: Array) -> Array:
    """Return the sum of each column and all columns after it."""
    return np.asarray(np.cumsum(rows[:, ::-1], axis=1)[:, ::-1])


def _stack_components(rows: Array) -> Array:
    """Return the real (east) rows above the imaginary (north) rows."""
    return np.concatenate([rows.real, rows.imag])


def _average_modes(sections: list[_SectionModel]) -> Array:
    """Return the logarithms of the variance components, averaged over all modes of the posterior.

    Drifting odometry and correlated fix errors may explain a drive equally well.
    """
    if not sections:
        return np.zeros(len(_LOG_VARIANCE_SIGMA))
    expected = _minimise_cost(sections, _START_LOG_VARIANCES[0], [(0.0, 0.0)] * 3 + _LOG_VARIANCE_BOUNDS[3:])
    modes: list[OptimizeResult] = []
    for start in (expected.x, *_START_LOG_VARIANCES[1:]):
        optimum = _minimise_cost(sections, start, _LOG_VARIANCE_BOUNDS)
        if not any(np.abs(optimum.x - mode.x).max() < _MODE_SEPARATION for mode in modes):
            modes.append(optimum)
    best = min(mode.fun for mode in modes)
    mode_weight = np.exp([best - mode.fun for mode in modes])
    logs = np.log(np.average([np.exp(mode.x) for mode in modes], axis=0, weights=mode_weight))
    # Sigmas grow on weak evidence and shrink on strong evidence only.
    return np.asarray(logs if best < expected.fun - _MIN_LOG_POSTERIOR_GAIN else np.maximum(logs, 0.0))


def _minimise_cost(
    sections: list[_SectionModel], start: Array, bounds: list[tuple[float, float]]
) -> OptimizeResult:
    # The import takes a quarter of a second, and only a drive with fixes needs it.
    """Minimise the negative log posterior from one start."""
    from scipy.optimize import minimize

    return minimize(
        _negative_log_posterior,
        start,
        (sections,),
        "L-BFGS-B",
        True,
        bounds=bounds,
        options={"ftol": _NOISE_COST_TOLERANCE},
    )


def _negative_log_posterior(logs: Array, sections: list[_SectionModel]) -> tuple[float, Array]:
    """Return the negative log posterior and its gradient."""
    cost, gradient = 0.5 * float(np.sum((logs / _LOG_VARIANCE_SIGMA) ** 2)), logs / _LOG_VARIANCE_SIGMA**2
    variances = np.exp(logs)
    for section in sections:
        cholesky_factor = cholesky(
            section.start_covariance + np.tensordot(variances, section.unit_covariances, 1), lower=True
        )
        root = solve_triangular(cholesky_factor, np.eye(len(section.y)), lower=True)
        whitened = root @ section.y
        cost += float(np.log(np.diag(cholesky_factor)).sum() + 0.5 * whitened @ whitened)
        inverse, weighted = root.T @ root, root.T @ whitened
        gradient_matrix = inverse - np.outer(weighted, weighted)
        gradient = gradient + 0.5 * variances * np.einsum(
            "kij,ij->k", section.unit_covariances, gradient_matrix
        )
    return cost, gradient
