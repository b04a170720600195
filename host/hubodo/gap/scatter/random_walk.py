"""A gyro bias that wanders: the likelihood of window means under a random walk in white noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.innovations import winsorised
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.walk import scores, walked
from hubodo.gap.process_noise.wheel_phase import WINDOW, windows
from hubodo.gap.scatter.base import Proposal, shared, single_cost
from hubodo.gap.state.terms import ModelTerm

NAME = "gyro_rate_random_walk"
_GRID = np.geomspace(1e-6, 3e-2, 28)
# Rounding leaves a little more than sensor noise in the means.
_WORTH = 3.0
# A walk can pass for any slow drift: it has to be better than those by more than chance.
_RELUCTANCE = 2.0
# Sigmas by which its innovations may differ from Gaussian and white ones.
_STEADY = 4.0


def look_for_random_walk(residuals: Sequence[Residual]) -> list[Proposal]:
    """k by maximum likelihood; the three axes of a node, or of all nodes, share it."""
    curves = {one.node.name: _curve(one) for one in residuals if BY_NAME[NAME] not in one.effects}
    made = []
    for scope, members in shared([one for one in residuals if one.node.name in curves]):
        curve = np.sum([curves[one.node.name] for one in members], axis=0)
        at = int(np.argmax(curve))
        if curve[at] < _WORTH or at == len(_GRID) - 1:
            continue
        k, sigma = _refined(curve, at)
        if not all(_steady(one, k) for one in members):
            continue
        cost = single_cost(sum(len(windows(one.node.t)) for one in members))
        made.append(
            Proposal(
                ModelTerm(BY_NAME[NAME](k=k), scope),  # type: ignore[call-arg]
                float(curve[at]),
                float(curve[at]) - cost - _RELUCTANCE,
                {"k": sigma},
                "means of the gyro channels wander from one second to the next as a random walk does",
            )
        )
    return made


def _curve(residual: Residual) -> Array:
    """(28,) gain of ln likelihood of one node for each k of the grid."""
    total = np.zeros(len(_GRID))
    for mean, variance, steps in _means(residual):
        tried = np.array([0.0, *_GRID**2])
        found = scores(mean, variance, steps, tried, tried * WINDOW)
        total += found[1:] - found[0]
    return total


def _means(residual: Residual) -> Iterator[tuple[Array, Array, Array]]:
    """For each gyro axis in use: mean of each window, (K,), its variance, and the seconds between them."""
    edges = windows(residual.node.t)
    steps = np.diff(np.add.reduceat(residual.node.t, edges[:-1]) / np.diff(edges))
    tamed = winsorised(residual.value / residual.noise.found) * residual.noise.found
    for row in np.flatnonzero(residual.node.used[:3]):
        weight = (residual.noise.fresh & ~residual.node.clipped[row]) / residual.noise.found[row] ** 2
        information = np.maximum(np.add.reduceat(weight, edges[:-1]), 1e-12)
        mean = np.add.reduceat(weight * tamed[row], edges[:-1]) / information
        yield mean, 1.0 / information + residual.input_variance[row], steps


def _steady(residual: Residual, k: float) -> bool:
    """Whether the innovations are those of a walk: as Gaussian and as large at all times, and in each axis.

    A step, a drift that comes and goes with speed or turns, or a channel of its own are something else.
    """
    sizes = []
    for mean, variance, steps in _means(residual):
        z = walked(mean, variance, steps, k**2, k**2 * WINDOW).innovation
        slack = _STEADY * np.sqrt(1.0 / len(z))
        if np.mean(z**4) / np.mean(z**2) ** 2 - 3.0 > slack * np.sqrt(24.0) + 0.2:
            return False
        # Correlation from one to the next, and of their sizes.
        size = z**2 - np.mean(z**2)
        if abs(np.mean(z[1:] * z[:-1])) > (slack + 0.05) * np.mean(z**2):
            return False
        if np.mean(size[1:] * size[:-1]) > (slack + 0.05) * np.mean(size**2):
            return False
        sizes.append(float(np.mean(z**2)))
    return bool(max(sizes) < 1.0 + _STEADY * np.sqrt(2.0 / len(z)) + 0.3)


def _refined(curve: Array, at: int) -> tuple[float, float]:
    """k at the top of the parabola through the best three, and its 1 sigma."""
    at = min(max(at, 1), len(_GRID) - 2)
    low, middle, high = curve[at - 1 : at + 2]
    step = float(np.log(_GRID[1] / _GRID[0]))
    bend = (low - 2.0 * middle + high) / step**2
    slope = (high - low) / (2.0 * step)
    if bend >= 0.0:
        return float(_GRID[at]), float(_GRID[at])
    shift = float(np.clip(-slope / bend, -step, step))
    k = float(_GRID[at] * np.exp(shift))
    return k, k / float(np.sqrt(-bend))
