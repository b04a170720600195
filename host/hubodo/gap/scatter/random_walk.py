"""A gyro bias that wanders: the likelihood of window means under a random walk in white noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.innovations import winsorised
from hubodo.gap.scatter.base import Proposal, Rest, shared, single_cost
from hubodo.gap.terms import Term
from hubodo.gap.walk import scores, walked
from hubodo.gap.wheel_phase import WINDOW, windows

NAME = "gyro_rate_random_walk"
_GRID = np.geomspace(1e-6, 3e-2, 28)
# Rounding leaves a little more than sensor noise in the means.
_WORTH = 3.0
# A walk can pass for any slow drift: it has to be better than those by more than chance.
_RELUCTANCE = 2.0
# Sigmas by which its innovations may differ from Gaussian and white ones.
_STEADY = 4.0


def look_for_random_walk(rests: Sequence[Rest]) -> list[Proposal]:
    """k by maximum likelihood; the three axes of a node, or of all nodes, share it."""
    curves = {rest.node.name: _curve(rest) for rest in rests if BY_NAME[NAME] not in rest.effects}
    made = []
    for scope, members in shared([rest for rest in rests if rest.node.name in curves]):
        curve = np.sum([curves[rest.node.name] for rest in members], axis=0)
        at = int(np.argmax(curve))
        if curve[at] < _WORTH or at == len(_GRID) - 1:
            continue
        k, sigma = _refined(curve, at)
        if not all(_steady(rest, k) for rest in members):
            continue
        cost = single_cost(sum(len(windows(rest.node.t)) for rest in members))
        made.append(
            Proposal(
                Term(BY_NAME[NAME](k=k), scope),  # type: ignore[call-arg]
                float(curve[at]),
                float(curve[at]) - cost - _RELUCTANCE,
                {"k": sigma},
                "means of the gyro channels wander from one second to the next as a random walk does",
            )
        )
    return made


def _curve(rest: Rest) -> Array:
    """(28,) gain of ln likelihood of one node for each k of the grid."""
    total = np.zeros(len(_GRID))
    for mean, variance, steps in _means(rest):
        tried = np.array([0.0, *_GRID**2])
        found = scores(mean, variance, steps, tried, tried * WINDOW)
        total += found[1:] - found[0]
    return total


def _means(rest: Rest) -> Iterator[tuple[Array, Array, Array]]:
    """For each gyro axis in use: mean of each window, (K,), its variance, and the seconds between them."""
    edges = windows(rest.node.t)
    steps = np.diff(np.add.reduceat(rest.node.t, edges[:-1]) / np.diff(edges))
    tamed = winsorised(rest.residual / rest.noise.found) * rest.noise.found
    for row in np.flatnonzero(rest.node.used[:3]):
        weight = (rest.noise.fresh & ~rest.node.clipped[row]) / rest.noise.found[row] ** 2
        information = np.maximum(np.add.reduceat(weight, edges[:-1]), 1e-12)
        mean = np.add.reduceat(weight * tamed[row], edges[:-1]) / information
        yield mean, 1.0 / information + rest.input_variance[row], steps


def _steady(rest: Rest, k: float) -> bool:
    """Whether the innovations are those of a walk: as Gaussian and as large at all times, and in each axis.

    A step, a drift that comes and goes with speed or turns, or a channel of its own are something else.
    """
    sizes = []
    for mean, variance, steps in _means(rest):
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
