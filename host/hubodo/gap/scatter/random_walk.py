"""Gyro rate random walk: likelihood of window means under a random walk in white noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION
from hubodo.gap.scatter.base import Proposal, group_by_scope, parameter_cost
from hubodo.gap.scatter.window_means import K_GRID, AxisMeans, compute_window_means
from hubodo.gap.state.terms import ModelTerm

EFFECT_NAME = "gyro_rate_random_walk"
_FINE_GRID_SIZE = 25
_FINE_GRID_WIDTH = float(np.log(K_GRID[1] / K_GRID[0]))
# Gain of ln likelihood; noise that is not white reaches 5.
_MIN_RANDOM_WALK_GAIN = 10.0
# Slow noise that is no walk: standard deviations in rad/s, and correlation times in windows.
_STATIONARY_SIGMAS, _SLOW_NOISE_WINDOWS = np.geomspace(1e-5, 0.1, 32), (1.0, 2.0, 4.0)
_MIN_GAIN_OVER_SLOW_NOISE = 2.0
# Evidence deducted because a walk can imitate any slow drift.
_DRIFT_PENALTY = 2.0
# Time constants of smooth drifts, s; parameters of such a drift in each axis.
_DRIFT_TIMES, _N_DRIFT_PARAMETERS = np.geomspace(5.0, 640.0, 8), 2
# Sigmas by which the innovations may differ from Gaussian white noise.
_MAX_WHITENESS_SIGMA = 4.0
# Largest share of windows that are bumps of the road, and how often they are searched.
_MAX_BUMP_SHARE, _N_BUMP_PASSES = 0.1, 2
# Correlation of squared innovations beyond chance where the roughness of a road varies.
_MAX_ROUGHNESS_CORRELATION = 0.12
# Loss in ln likelihood by one k for all nodes beyond which they have walks of their own: 3 sigma.
_MAX_LOSS_BY_SHARING = 0.5 * 3.0**2
# Gain from which on an axis shows a walk at all, and the variance of its innovations below which its noise is
# declared too large to show whether they are white.
_MIN_AXIS_GAIN, _MIN_AXIS_VARIANCE = 2.0, 0.5


def detect_random_walk(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect a random walk; k by maximum likelihood, shared by the three axes of a node or of all nodes."""
    means = {
        one.node.name: list(compute_window_means(one))
        for one in residuals
        if BY_NAME[EFFECT_NAME] not in one.effects
    }
    proposals = []
    for scope, members in group_by_scope([one for one in residuals if one.node.name in means]):
        nodes = [means[one.node.name] for one in members]
        regular = _remove_bumps(nodes)
        k, sigma, gain = _fit_walk([axis for node in regular for axis in node])
        cost = parameter_cost(sum(len(node[0].mean) for node in nodes if node))
        is_step = sum(_step_evidence(node) for node in nodes) > gain - cost
        if gain < _MIN_RANDOM_WALK_GAIN or is_step or not _is_random_walk(regular, k, gain):
            continue
        axes = [axis for node in regular for axis in node]
        smooth_advantage = _gain_of_smooth_drift(axes) - gain
        if smooth_advantage > (1 + _N_DRIFT_PARAMETERS * len(axes)) * parameter_cost(len(axes[0].mean)):
            continue
        if _count_windows(regular) < (1.0 - _MAX_BUMP_SHARE) * _count_windows(nodes):
            continue
        term = ModelTerm(BY_NAME[EFFECT_NAME](k=k), scope)  # type: ignore[call-arg]
        where = "means of the gyro channels drift from one second to the next as a random walk does"
        evidence = gain - cost - _DRIFT_PENALTY
        proposals.append(
            Proposal(term, gain, evidence, {"k": sigma}, where, smooth_advantage=smooth_advantage)
        )
    return proposals


def _fit_walk(axes: Sequence[AxisMeans]) -> tuple[float, float, float]:
    """Return the most likely k, its 1 sigma and its gain; no gain if k is at the end of the grid.

    With many windows the likelihood is much narrower than the steps of the coarse grid.
    """
    best = _best_on_grid(axes)
    if best == len(K_GRID) - 1:
        return float(K_GRID[-1]), float(K_GRID[-1]), 0.0
    fine_grid = K_GRID[best] * np.exp(np.linspace(-1.0, 1.0, _FINE_GRID_SIZE) * _FINE_GRID_WIDTH)
    curve = _sum_gains(axes, fine_grid)
    return *_refine_peak(curve, fine_grid), float(np.max(curve))


def _count_windows(nodes: Sequence[Sequence[AxisMeans]]) -> int:
    return sum(len(axis.mean) for node in nodes for axis in node)


def _remove_bumps(nodes: Sequence[Sequence[AxisMeans]]) -> list[list[AxisMeans]]:
    """Return the means of each node without bumps, which enlarge the first estimate of the walk."""
    regular = [list(node) for node in nodes]
    for _ in range(_N_BUMP_PASSES):
        k = float(K_GRID[_best_on_grid([axis for node in regular for axis in node])])
        regular = [[axis.without_bumps(k) for axis in node] for node in nodes]
    return regular


def _best_on_grid(axes: Sequence[AxisMeans]) -> int:
    """Return the index of the most likely k of the coarse grid; the last one without axes."""
    return int(np.argmax(np.sum([axis.coarse_gain for axis in axes], axis=0))) if axes else len(K_GRID) - 1


def _sum_gains(axes: Sequence[AxisMeans], grid: Array) -> Array:
    return np.asarray(np.sum([axis.gain(grid) for axis in axes], axis=0))


def _gain_of_slow_noise(axes: Sequence[AxisMeans]) -> float:
    """Return the largest gain of noise of one size in all axes that is slower than a window."""
    times = WINDOW_DURATION * np.array(_SLOW_NOISE_WINDOWS)
    return float(
        max(
            np.max(np.sum([axis.stationary_gain(_STATIONARY_SIGMAS, time) for axis in axes], axis=0))
            for time in times
        )
    )


def _gain_of_smooth_drift(axes: Sequence[AxisMeans]) -> float:
    """Return the largest gain of a constant and an exponential per axis, with one time constant for all.

    Where such a drift leaves white noise, as a warm-up does, its gain exceeds that of a walk, which also
    follows noise.
    """
    return float(max(sum(_gain_of_exponential(axis, time) for axis in axes) for time in _DRIFT_TIMES))


def _gain_of_exponential(axis: AxisMeans, time_constant: float) -> float:
    times = np.concatenate([[0.0], np.cumsum(axis.steps)])
    shapes = np.column_stack([np.ones(len(times)), np.exp(-times / time_constant)])
    scale = 1.0 / np.sqrt(axis.variance)
    basis, _ = np.linalg.qr(shapes * scale[:, None])
    return float(0.5 * np.sum((basis.T @ (axis.mean * scale)) ** 2))


def _is_random_walk(nodes: Sequence[Sequence[AxisMeans]], k: float, gain: float) -> bool:
    """Return True if each node shows the walk, and slow noise that returns to zero explains less."""
    if not all(
        _sum_gains(node, np.array([k]))[0] > 0.0 and _has_white_innovations(node, k) for node in nodes
    ):
        return False
    own_gains = [_fit_walk(node)[2] for node in nodes] if len(nodes) > 1 else [gain]
    return (
        gain > sum(own_gains) - _MAX_LOSS_BY_SHARING
        and gain > _gain_of_slow_noise([axis for node in nodes for axis in node]) + _MIN_GAIN_OVER_SLOW_NOISE
    )


def _has_white_innovations(axes: Sequence[AxisMeans], k: float) -> bool:
    """Return True if the innovations are Gaussian, white and equally large at all times and in all axes.

    A step, a drift that depends on speed or turns, or a drift of one channel alone fail this test.
    """
    n_informative, innovations = 0, []
    for axis in axes:
        z = axis.standardise(k)
        variance = float(np.mean(z**2))
        if variance > 1.3 + _MAX_WHITENESS_SIGMA * np.sqrt(2.0 / len(z)):
            return False
        if axis.gain(np.array([k]))[0] > _MIN_AXIS_GAIN:
            n_informative += 1
            if variance > _MIN_AXIS_VARIANCE:
                innovations.append(z / np.sqrt(variance))
    return n_informative >= min(2, len(axes)) and (not innovations or _are_white(innovations))


def _are_white(innovations: Sequence[Array]) -> bool:
    """Return True if innovations, (K,) of unit variance each, are Gaussian, and like their squares white.

    Tested is the mean over the axes: a road of varying roughness is the same for all of them.
    """
    statistics = []
    for z in innovations:
        square = z**2 - 1.0
        square_correlation = np.mean(square[1:] * square[:-1]) / np.mean(square**2)
        statistics.append((np.mean(z**4) - 3.0, abs(np.mean(z[1:] * z[:-1])), square_correlation))
    kurtosis, correlation, square_correlation = np.mean(statistics, axis=0)
    tolerance = _MAX_WHITENESS_SIGMA / np.sqrt(min(len(z) for z in innovations))
    return bool(
        kurtosis < tolerance * np.sqrt(24.0) + 0.2
        and correlation < tolerance + 0.05
        and square_correlation < tolerance + _MAX_ROUGHNESS_CORRELATION
    )


def _step_evidence(axes: Sequence[AxisMeans]) -> float:
    """Return the evidence, in nats, of one common step of all gyro axes at the best time, without a walk.

    The number of possible times is penalised, and the amplitude of each axis as in BIC.
    """
    gains = np.zeros(1)
    for axis in axes:
        weight = np.cumsum((1.0 / axis.variance)[::-1])[::-1]
        gains = gains + 0.5 * np.cumsum((axis.mean / axis.variance)[::-1])[::-1] ** 2 / weight
    # A step at the first window is a constant offset, which is another effect.
    n_windows = len(gains)
    return float(gains[1:].max(initial=0.0) - np.log(n_windows)) - len(axes) * parameter_cost(n_windows)


def _refine_peak(curve: Array, grid: Array) -> tuple[float, float]:
    """Return k at the vertex of the parabola through the best three grid points, and its 1 sigma.

    grid: values of k, with equal steps in ln k
    """
    best = min(max(int(np.argmax(curve)), 1), len(grid) - 2)
    low, middle, high = curve[best - 1 : best + 2]
    step = float(np.log(grid[1] / grid[0]))
    curvature = (low - 2.0 * middle + high) / step**2
    slope = (high - low) / (2.0 * step)
    if curvature >= 0.0:
        return float(grid[best]), float(grid[best])
    shift = float(np.clip(-slope / curvature, -step, step))
    k = float(grid[best] * np.exp(shift))
    return k, k / float(np.sqrt(-curvature))
