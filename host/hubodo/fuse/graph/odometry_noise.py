"""How noisy the odometry of a drive is, by what its fixes say of it: variance components of a solved graph.

About a solution all is linear: what the fixes lie beside the odometry is the sum of the noise of every
stretch of odometry before them, of the fixes' own noise, and of the start and the constants, which are
integrated out (restricted maximum likelihood, Patterson and Thompson 1971). The fixes may be wrong for long
as well, as those of real receivers are: else the odometry would be blamed for what satellites do.
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
"""Fixes; fewer cannot tell the noise of anything."""

_MAX_BLOCKS_PER_SECTION, _SECTION_DURATION, _MAX_SECTIONS = 60, 600.0, 4
"""Means of fixes that a stretch of a drive is looked at in, its length in s, and how many are looked at.

Ten seconds each at most, in which an odometry hardly strays; the work grows with the third power of their
number.
"""

_FIX_ERROR_TIMES = (15.0, 150.0)
"""s that errors of fixes last for: reflections off what one passes, and a sky that changes. Estimated."""

_CORRELATED_ERROR_RATIO = 0.05
"""Of a fix's sigma, the size that such errors are expected to have."""

_LOG_VARIANCE_SIGMA = np.array([1.4, 1.4, 2.0, 0.3, 3.0, 3.0])
"""1 sigma of the natural logarithm of each variance beforehand.

Noise of the odometry along and sideways, by a factor of two either way, and in heading, of three; the fixes'
own, which they declare and their scatter bears out; what lasts of them. Estimated.
"""

_START_LOG_VARIANCES = np.array(
    [
        *([0.0] * 6, [3.0, 3.0, 0.0, 0.0, 0.0, 0.0]),
        *([0.0, 0.0, 3.0, 0.0, 0.0, 0.0], [0.0, 0.0, 6.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 5.0, 5.0]),
    ]
)
"""Logarithms of the variances that are begun with: where noise is small it has no gradient."""

_LOG_VARIANCE_BOUNDS = [(-6.0, 4.0), (-6.0, 4.0), (-6.0, 8.0), *[(-6.0, 9.0)] * 3]
"""Logarithms of the variances, least and most.

What strays further than a foot in a metre is no odometry: fixes that jumped look like that. Estimated.
"""

_NOISE_COST_TOLERANCE = 1e-5
"""Of the cost, some hundreds: a gain below that changes no sigma."""

_MODE_SEPARATION = 1.0
"""In logarithms of variances, within which two optima are taken for one."""

_MIN_LOG_POSTERIOR_GAIN = 2.0
"""Logarithm of the posterior that less noise than expected must gain: two sigma."""

_START_POSE_SIGMA = np.array([30.0, 30.0, 0.5])
"""m, m, rad about the solution, within which the first pose is; wider than any solution is sure."""


@dataclass(frozen=True, eq=False)
class _SectionModel:
    """What a stretch of a drive says.

    y: (n,) m, means of fixes less where odometry alone would be, east before north. fixed: (n, n) m², what
    start and constants make of it. parts: (6, n, n), covariances for a variance of one, as _UNSURE has them.
    """

    y: Array
    start_covariance: Array
    unit_covariances: Array


def estimate_noise_factors(graph: FactorGraph, solution: Solution, pose_t: Array, constants: Array) -> Array:
    """By what the sigmas of the odometry along, sideways and in heading are to be multiplied, (3,).

    constants: (COUNT,) 1 sigma of the constants before the drive. Ones where there are too few fixes.
    """
    between, positions = graph.find(BetweenFactors), graph.find(PositionFactors)
    if between is None or positions is None:
        return np.ones(3)
    fixes = positions.linearise(solution.poses, solution.constants)
    good = np.flatnonzero(positions.loss.weight(fixes.squared_norms) > MIN_USED_WEIGHT)
    if len(good) < _MIN_FIXES_PER_SECTION:
        return np.ones(3)
    rows = between.linearise(solution.poses, solution.constants)
    sigma = positions.sigma
    seen = [
        _model_section(chosen, fixes, sigma, rows, between, solution, pose_t, constants)
        for chosen in _choose_sections(good, pose_t[fixes.pose_index])
    ]
    return np.exp(0.5 * _average_modes(seen)[:3])


def _choose_sections(good: IndexArray, t: Array) -> list[IndexArray]:
    """Numbers of the fixes of each stretch that is looked at, evenly over the drive."""
    whole = float(t[good[-1]] - t[good[0]])
    count = int(np.ceil(whole / _SECTION_DURATION))
    begins = t[good[0]] + whole / count * np.arange(count)
    if count > _MAX_SECTIONS:
        begins = begins[np.linspace(0, count - 1, _MAX_SECTIONS).astype(np.intp)]
    edges = np.searchsorted(t[good], np.column_stack([begins, begins + whole / count + 1e-9]))
    return [good[first:last] for first, last in edges.tolist() if last - first >= _MIN_FIXES_PER_SECTION]


def _model_section(
    chosen: IndexArray,
    fixes: LinearisedFactors,
    sigma: Array,
    rows: LinearisedFactors,
    between: BetweenFactors,
    solution: Solution,
    pose_t: Array,
    constants: Array,
) -> _SectionModel:
    """About a solution: a step (n_f, n_l, n_h) of noise moves all later places.

    dp_i = e^(i h_k) (n_f + i n_l) + i (p_i - p_(k+1)) n_h for every stretch k that ends before pose i.
    """
    state = fixes.pose_index[chosen]
    first, last = int(state[0]), int(state[-1])
    size = sigma[chosen]
    mean, white = _block_weights(len(chosen), size)
    place = solution.poses[first : last + 1, 0] + 1j * solution.poses[first : last + 1, 1]
    share = np.zeros((len(mean), last - first + 1))
    np.add.at(share.T, state - first, mean.T)
    later, weighted = _reverse_cumsum(share)[:, 1:], _reverse_cumsum(share * place)[:, 1:]
    ahead = np.exp(1j * solution.poses[first:last, 2])
    swung = 1j * (weighted - later * place[1:])
    moved = np.stack([later * ahead, 1j * later * ahead, swung])

    own = slice(first, last)
    unwhitened = np.linalg.inv(between.whitening[own])
    residual = (unwhitened @ rows.residual[own, :, None])[:, :, 0]
    by_constants = unwhitened @ rows.constants_jacobian[own]
    off = -fixes.residual[chosen] * size[:, None]
    by_delay = (fixes.constants_jacobian[chosen] * size[:, None, None]).transpose(1, 0, 2)
    told = mean @ (by_delay[0] + 1j * by_delay[1]) - np.einsum("abk,kac->bc", moved, by_constants)
    y = mean @ (off[:, 0] + 1j * off[:, 1]) + np.einsum("abk,ka->b", moved, residual)
    y = y + told @ solution.constants
    start = np.stack([np.ones(len(y)), 1j * np.ones(len(y)), 1j * (share @ place - place[0])], axis=1)
    certain = _stack_components(np.hstack([told * constants, start * _START_POSE_SIGMA]))
    steps = moved * np.sqrt(np.einsum("kii->ik", between.steps.covariance[own]))[:, None]
    t = mean @ pose_t[state]
    apart = np.abs(t[:, None] - t)
    size_lasting = (_CORRELATED_ERROR_RATIO * float(np.median(size))) ** 2
    parts = np.empty((len(_LOG_VARIANCE_SIGMA), 2 * len(mean), 2 * len(mean)))
    for part, step in zip(parts, steps, strict=False):
        part[:] = _stack_components(step) @ _stack_components(step).T
    parts[len(steps)] = np.diag(np.tile(white, 2))
    for part, length in zip(parts[len(steps) + 1 :], _FIX_ERROR_TIMES, strict=True):
        part[:] = size_lasting * np.kron(np.eye(2), np.exp(-apart / length))
    return _SectionModel(_stack_components(y[:, None])[:, 0], certain @ certain.T, parts)


def _block_weights(count: int, sigma: Array) -> tuple[Array, Array]:
    """Weights (blocks, count) that make means of successive fixes, and the variance of each."""
    blocks = min(_MAX_BLOCKS_PER_SECTION, count)
    edges = np.linspace(0, count, blocks + 1).astype(np.intp)
    mean = np.zeros((blocks, count))
    mean[np.repeat(np.arange(blocks), np.diff(edges)), np.arange(count)] = sigma**-2.0
    whole = mean.sum(axis=1)
    return mean / whole[:, None], 1.0 / whole


def _reverse_cumsum(rows: Array) -> Array:
    """Sums of each column and all columns after it."""
    return np.asarray(np.cumsum(rows[:, ::-1], axis=1)[:, ::-1])


def _stack_components(rows: Array) -> Array:
    """East above north."""
    return np.concatenate([rows.real, rows.imag])


def _average_modes(seen: list[_SectionModel]) -> Array:
    """Logarithms of the variances, in units of what was expected: means over all that the fixes allow.

    An odometry that strays and fixes that are wrong for long may explain a drive equally well.
    """
    if not seen:
        return np.zeros(len(_LOG_VARIANCE_SIGMA))
    expected = _minimise_cost(seen, _START_LOG_VARIANCES[0], [(0.0, 0.0)] * 3 + _LOG_VARIANCE_BOUNDS[3:])
    modes: list[OptimizeResult] = []
    for begin in (expected.x, *_START_LOG_VARIANCES[1:]):
        found = _minimise_cost(seen, begin, _LOG_VARIANCE_BOUNDS)
        if not any(np.abs(found.x - mode.x).max() < _MODE_SEPARATION for mode in modes):
            modes.append(found)
    best = min(mode.fun for mode in modes)
    weight = np.exp([best - mode.fun for mode in modes])
    logs = np.log(np.average([np.exp(mode.x) for mode in modes], axis=0, weights=weight))
    # Sigmas grow on little evidence and shrink on much.
    return np.asarray(logs if best < expected.fun - _MIN_LOG_POSTERIOR_GAIN else np.maximum(logs, 0.0))


def _minimise_cost(
    seen: list[_SectionModel], begin: Array, bounds: list[tuple[float, float]]
) -> OptimizeResult:
    # A quarter of a second of loading that only a drive with fixes needs.
    from scipy.optimize import minimize

    return minimize(
        _negative_log_posterior,
        begin,
        (seen,),
        "L-BFGS-B",
        True,
        bounds=bounds,
        options={"ftol": _NOISE_COST_TOLERANCE},
    )


def _negative_log_posterior(logs: Array, seen: list[_SectionModel]) -> tuple[float, Array]:
    """Minus the logarithm of the posterior, and its derivatives."""
    cost, slope = 0.5 * float(np.sum((logs / _LOG_VARIANCE_SIGMA) ** 2)), logs / _LOG_VARIANCE_SIGMA**2
    size = np.exp(logs)
    for item in seen:
        factor = cholesky(item.start_covariance + np.tensordot(size, item.unit_covariances, 1), lower=True)
        root = solve_triangular(factor, np.eye(len(item.y)), lower=True)
        white = root @ item.y
        cost += float(np.log(np.diag(factor)).sum() + 0.5 * white @ white)
        inverse, weighted = root.T @ root, root.T @ white
        lever = inverse - np.outer(weighted, weighted)
        slope = slope + 0.5 * size * np.einsum("kij,ij->k", item.unit_covariances, lever)
    return cost, slope
