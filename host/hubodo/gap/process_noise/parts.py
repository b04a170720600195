"""A long log in stretches of time: what is made of one goes before the next is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.wheel_phase import WINDOW

# Windows over which scores are added up: longer than what is left of any correlation.
BLOCK = 8
# Blocks of windows in one part.
_BLOCKS = 16


@dataclass(frozen=True)
class Stretch:
    """Some windows that follow each other, whole blocks of them but for the last part.

    begins: (K,) s, where each window does. samples: those of each node, at least one. edges: for each node
    (K + 1,), its first sample in each window, and the end, counted within the part.
    """

    begins: Array
    samples: Mapping[str, slice]
    edges: Mapping[str, NDArray[np.intp]]


def parts(problem: Problem) -> list[Stretch]:
    """All of a log, one part after the other."""
    grid = window_grid(problem)
    edges = {node.name: window_edges(grid, node) for node in problem.nodes}
    cuts = [0]
    for at in range(_BLOCKS * BLOCK, len(grid), _BLOCKS * BLOCK):
        # A node that is silent for so long is looked at with what is before or behind.
        if all(own[cuts[-1]] < own[at] < own[-1] for own in edges.values()):
            cuts.append(at)
    made = []
    for first, end in zip(cuts, [*cuts[1:], len(grid)], strict=True):
        samples = {name: slice(int(own[first]), int(own[end])) for name, own in edges.items()}
        inside = {name: own[first : end + 1] - own[first] for name, own in edges.items()}
        made.append(Stretch(grid[first:end], samples, inside))
    return made


def window_grid(problem: Problem) -> Array:
    """(K,) s, where each window begins."""
    first = min(node.t[0] for node in problem.nodes)
    last = max(node.t[-1] for node in problem.nodes)
    return np.arange(first, last, WINDOW)


def window_edges(grid: Array, node: NodeData) -> NDArray[np.intp]:
    """(K+1,) the first sample of a node in each window, and the end."""
    return np.append(np.searchsorted(node.t, grid), len(node.t))


def window_of(grid: Array, t: Array) -> NDArray[np.intp]:
    """(N,): in which window of a grid each time is."""
    return np.clip(np.searchsorted(grid, t, side="right") - 1, 0, None)


def window_means(value: Array, edges: NDArray[np.intp]) -> Array:
    """(K,) mean in each window; where there are no samples, as before and after."""
    count = np.diff(edges)
    total = np.diff(np.concatenate([[0.0], np.cumsum(value)])[edges])
    at = np.arange(len(count))
    return np.asarray(np.interp(at, at[count > 0], total[count > 0] / count[count > 0]))
