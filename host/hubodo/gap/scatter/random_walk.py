"""Gyro rate random walk: likelihood of window means under a random walk in white noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION, window_boundaries
from hubodo.gap.process_noise.window_sums import winsorise
from hubodo.gap.scatter.base import Proposal, group_by_scope, parameter_cost
from hubodo.gap.state.terms import ModelTerm

EFFECT_NAME = "gyro_rate_random_walk"
_K_GRID, _FINE_GRID_SIZE = np.geomspace(1e-6, 3e-2, 28), 25
# Gain of ln likelihood; rounding alone adds slightly more than sensor noise to the means.
_MIN_DETECTION_GAIN = 3.0
# Evidence deducted because a walk can imitate any slow drift.
_DRIFT_PENALTY = 2.0
# Sigmas by which the innovations may differ from Gaussian white noise.
_MAX_WHITENESS_SIGMA = 4.0


def detect_random_walk(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect a random walk; k by maximum likelihood, shared by the three axes of a node or of all nodes."""
    curves = {one.node.name: _gain_curve(one) for one in residuals if BY_NAME[EFFECT_NAME] not in one.effects}
    proposals = []
    for scope, members in group_by_scope([one for one in residuals if one.node.name in curves]):
        curve = np.sum([curves[one.node.name] for one in members], axis=0)
        best = int(np.argmax(curve))
        if curve[best] < _MIN_DETECTION_GAIN or best == len(_K_GRID) - 1:
            continue
        # With many windows the likelihood is much narrower than the steps of the coarse grid.
        fine_grid = _K_GRID[best] * np.exp(
            np.linspace(-1.0, 1.0, _FINE_GRID_SIZE) * np.log(_K_GRID[1] / _K_GRID[0])
        )
        k, sigma = _refine_peak(np.sum([_gain_curve(one, fine_grid) for one in members], axis=0), fine_grid)
        if not all(_is_random_walk(one, k) for one in members):
            continue
        cost = parameter_cost(sum(len(window_boundaries(one.node.t)) for one in members))
        if sum(_step_evidence(one) for one in members) > float(curve[best]) - cost:
            continue
        proposals.append(
            Proposal(
                ModelTerm(BY_NAME[EFFECT_NAME](k=k), scope),  # type: ignore[call-arg]
                float(curve[best]),
                float(curve[best]) - cost - _DRIFT_PENALTY,
                {"k": sigma},
                "means of the gyro channels wander from one second to the next as a random walk does",
            )
        )
    return proposals


def _gain_curve(residual: Residual, grid: Array = _K_GRID) -> Array:
    """Return the gain of ln likelihood of one node, (G,), for each k of the grid."""
    total = np.zeros(len(grid))
    for mean, variance, steps in _window_means(residual):
        innovation, covariance = _innovations(mean, variance, steps, np.array([0.0, *grid**2]))
        likelihoods = -0.5 * (innovation**2 / covariance + np.log(covariance)).sum(axis=0)
        total += likelihoods[1:] - likelihoods[0]
    return total


def _innovations(mean: Array, variance: Array, steps: Array, intensities: Array) -> tuple[Array, Array]:
    """Return the innovation of each window mean and its variance, (K, G) each, for each k².

    The mean of a walk over a window of length W differs from its value at the start by noise of variance k² W
    / 3, of which k² W / 2 is common with the step over the window. Treating means as points of the walk would
    underestimate k, by up to √(2/3) where the walk dominates.
    """
    x, v = np.zeros_like(intensities), intensities * WINDOW_DURATION
    innovation, variances = np.empty((len(mean), len(intensities))), np.empty((len(mean), len(intensities)))
    for k, (z, r, step) in enumerate(
        zip(mean.tolist(), variance.tolist(), [*steps.tolist(), 0.0], strict=True)
    ):
        innovation[k] = z - x
        variances[k] = v + r + intensities * (WINDOW_DURATION / 3.0)
        shared_part = v + intensities * (0.5 * WINDOW_DURATION)
        x = x + shared_part / variances[k] * innovation[k]
        v = v + intensities * step - shared_part**2 / variances[k]
    return innovation, variances


def _window_means(residual: Residual) -> Iterator[tuple[Array, Array, Array]]:
    """Yield for each gyro axis the window means, (K,), their variances, and the s between windows."""
    edges = window_boundaries(residual.node.t)
    steps = np.diff(np.add.reduceat(residual.node.t, edges[:-1]) / np.diff(edges))
    for row in np.flatnonzero(residual.node.used[:3]):
        sigma = residual.noise.channel_sigma(row)
        winsorised = winsorise(residual.value[[row]] / sigma)[0] * sigma
        weight = (residual.noise.is_new & ~residual.node.is_saturated[row]) / sigma**2
        information = np.maximum(np.add.reduceat(weight, edges[:-1]), 1e-12)
        mean = np.add.reduceat(weight * winsorised, edges[:-1]) / information
        yield mean, 1.0 / information + residual.input_variance[row], steps


def _is_random_walk(residual: Residual, k: float) -> bool:
    """Return True if the innovations are Gaussian, white and equally large at all times and in all axes.

    A step, a drift that depends on speed or turns, or a drift of one channel alone fail this test.
    """
    variances = []
    for mean, variance, steps in _window_means(residual):
        innovation, covariance = _innovations(mean, variance, steps, np.array([k**2]))
        z = (innovation / np.sqrt(covariance))[:, 0]
        tolerance = _MAX_WHITENESS_SIGMA * np.sqrt(1.0 / len(z))
        if np.mean(z**4) / np.mean(z**2) ** 2 - 3.0 > tolerance * np.sqrt(24.0) + 0.2:
            return False
        # Autocorrelation of the innovations, and of their squares.
        centred_square = z**2 - np.mean(z**2)
        if abs(np.mean(z[1:] * z[:-1])) > (tolerance + 0.05) * np.mean(z**2):
            return False
        if np.mean(centred_square[1:] * centred_square[:-1]) > (tolerance + 0.05) * np.mean(
            centred_square**2
        ):
            return False
        variances.append(float(np.mean(z**2)))
    return bool(max(variances) < 1.0 + _MAX_WHITENESS_SIGMA * np.sqrt(2.0 / len(z)) + 0.3)


def _step_evidence(residual: Residual) -> float:
    """Return the evidence, in nats, of one common step of all gyro axes at the best time, without a walk.

    The number of possible times is penalised, and the amplitude of each axis as in BIC.
    """
    gains, count = np.zeros(1), 0
    for mean, variance, _ in _window_means(residual):
        weight = np.cumsum((1.0 / variance)[::-1])[::-1]
        gains = gains + 0.5 * np.cumsum((mean / variance)[::-1])[::-1] ** 2 / weight
        count += 1
    # A step at the first window is a constant offset, which is another effect.
    n_windows = len(gains)
    return float(gains[1:].max(initial=0.0) - np.log(n_windows)) - count * parameter_cost(n_windows)


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
