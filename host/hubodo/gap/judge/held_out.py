"""What is held out: stretches of another kind than those that are fitted, not just a later part."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.gap.problem.problem import Problem
from hubodo.gap.process_noise.residual import Masks
from hubodo.gap.process_noise.weights import Weights

_STRETCH = 10.0
_LEAST, _MOST = 0.15, 0.45


@dataclass(frozen=True)
class Split:
    """inside: for each node (N,), the samples that are held out. kind: what they are, in words."""

    inside: Masks
    kind: str

    def without(self, weights: Weights) -> Weights:
        """Weights under which what is held out counts for nothing in a fit."""
        noise = {name: one.without(self.inside[name]) for name, one in weights.noise.items()}
        return replace(weights, noise=noise)


def split(problem: Problem) -> Split:
    """Stretches of ten seconds sorted by how fast and how much in turns they are; one kind is held out.

    A log in which nothing differs has every third stretch held out.
    """
    edges = np.arange(problem.nodes[0].t[0], problem.nodes[0].t[-1] + _STRETCH, _STRETCH)
    count = len(edges) - 1
    grid = np.linspace(edges[0], edges[-1], 20 * count, endpoint=False)
    body = problem.inputs.at(grid)
    speed = np.sqrt((body.speed**2).reshape(count, -1).mean(axis=1))
    turning = np.sqrt((body.yaw_rate**2).reshape(count, -1).mean(axis=1))
    kinds = {
        "fast with turns": (speed > np.median(speed)) & (turning > np.median(turning)),
        "slow with turns": (speed <= np.median(speed)) & (turning > np.median(turning)),
        "fast and straighter": (speed > np.median(speed)) & (turning <= np.median(turning)),
    }
    for words, chosen in kinds.items():
        if _LEAST <= chosen.mean() <= _MOST and np.ptp(speed) > 0.05:
            return Split(_samples(problem, edges, chosen), f"stretches that are {words}")
    third = np.arange(count) % 3 == 1
    return Split(_samples(problem, edges, third), "every third stretch of ten seconds")


def _samples(problem: Problem, edges: NDArray[np.float64], chosen: NDArray[np.bool_]) -> Masks:
    made = {}
    for node in problem.nodes:
        at = np.clip(np.searchsorted(edges, node.t, side="right") - 1, 0, len(chosen) - 1)
        made[node.name] = chosen[at]
    return made
