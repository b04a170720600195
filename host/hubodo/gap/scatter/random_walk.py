"""A gyro bias that wanders: the likelihood of window means under a random walk in white noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.process_noise.wheel_phase import WINDOW, windows
from hubodo.gap.process_noise.window_sums import winsorised
from hubodo.gap.scatter.base import Proposal, shared, single_cost
from hubodo.gap.state.terms import ModelTerm

NAME = "gyro_rate_random_walk"
_GRID, _FINER = np.geomspace(1e-6, 3e-2, 28), 25
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
        # Many windows know k far better than the steps of the grid, over which no likelihood is a parabola.
        fine = _GRID[at] * np.exp(np.linspace(-1.0, 1.0, _FINER) * np.log(_GRID[1] / _GRID[0]))
        k, sigma = _refined(np.sum([_curve(one, fine) for one in members], axis=0), fine)
        if not all(_steady(one, k) for one in members):
            continue
        cost = single_cost(sum(len(windows(one.node.t)) for one in members))
        if sum(_as_a_step(one) for one in members) > float(curve[at]) - cost:
            continue
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


def _curve(residual: Residual, grid: Array = _GRID) -> Array:
    """(G,) gain of ln likelihood of one node for each k of the grid, (G,)."""
    total = np.zeros(len(grid))
    for mean, variance, steps in _means(residual):
        off, spread = _innovations(mean, variance, steps, np.array([0.0, *grid**2]))
        found = -0.5 * (off**2 / spread + np.log(spread)).sum(axis=0)
        total += found[1:] - found[0]
    return total


def _innovations(mean: Array, variance: Array, steps: Array, intensities: Array) -> tuple[Array, Array]:
    """(K, G) each window's mean less what those before it tell, and the variance of that, for each k².

    A mean of a walk over a window of length W differs from where the walk was when the window began by noise
    of variance k² W / 3, which has k² W / 2 in common with the walk's way through it: a filter that takes
    the means for points of the walk finds k too small, by up to the root of two thirds where the walk is all
    there is.
    """
    x, v = np.zeros_like(intensities), intensities * WINDOW
    off, spread = np.empty((len(mean), len(intensities))), np.empty((len(mean), len(intensities)))
    for k, (z, r, step) in enumerate(
        zip(mean.tolist(), variance.tolist(), [*steps.tolist(), 0.0], strict=True)
    ):
        off[k] = z - x
        spread[k] = v + r + intensities * (WINDOW / 3.0)
        shared_part = v + intensities * (0.5 * WINDOW)
        x = x + shared_part / spread[k] * off[k]
        v = v + intensities * step - shared_part**2 / spread[k]
    return off, spread


def _means(residual: Residual) -> Iterator[tuple[Array, Array, Array]]:
    """For each gyro axis in use: mean of each window, (K,), its variance, and the seconds between them."""
    edges = windows(residual.node.t)
    steps = np.diff(np.add.reduceat(residual.node.t, edges[:-1]) / np.diff(edges))
    for row in np.flatnonzero(residual.node.used[:3]):
        found = residual.noise.of(row)
        tamed = winsorised(residual.value[[row]] / found)[0] * found
        weight = (residual.noise.fresh & ~residual.node.clipped[row]) / found**2
        information = np.maximum(np.add.reduceat(weight, edges[:-1]), 1e-12)
        mean = np.add.reduceat(weight * tamed, edges[:-1]) / information
        yield mean, 1.0 / information + residual.input_variance[row], steps


def _steady(residual: Residual, k: float) -> bool:
    """Whether the innovations are those of a walk: as Gaussian and as large at all times, and in each axis.

    A step, a drift that comes and goes with speed or turns, or a channel of its own are something else.
    """
    sizes = []
    for mean, variance, steps in _means(residual):
        off, spread = _innovations(mean, variance, steps, np.array([k**2]))
        z = (off / np.sqrt(spread))[:, 0]
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


def _as_a_step(residual: Residual) -> float:
    """Evidence, in nats, of one step of all gyro axes at once, at the time that fits best, and no walk.

    Its time is one of all windows; each axis pays for its amplitude as in BIC.
    """
    gains, count = np.zeros(1), 0
    for mean, variance, _ in _means(residual):
        weight = np.cumsum((1.0 / variance)[::-1])[::-1]
        gains = gains + 0.5 * np.cumsum((mean / variance)[::-1])[::-1] ** 2 / weight
        count += 1
    # From the first window on it is an offset, which is another name.
    places = len(gains)
    return float(gains[1:].max(initial=0.0) - np.log(places)) - count * single_cost(places)


def _refined(curve: Array, grid: Array) -> tuple[float, float]:
    """k at the top of the parabola through the best three of an even grid in ln k, and its 1 sigma."""
    at = min(max(int(np.argmax(curve)), 1), len(grid) - 2)
    low, middle, high = curve[at - 1 : at + 2]
    step = float(np.log(grid[1] / grid[0]))
    bend = (low - 2.0 * middle + high) / step**2
    slope = (high - low) / (2.0 * step)
    if bend >= 0.0:
        return float(grid[at]), float(grid[at])
    shift = float(np.clip(-slope / bend, -step, step))
    k = float(grid[at] * np.exp(shift))
    return k, k / float(np.sqrt(-bend))
