"""Windows and segments of a long log, which are processed one after the other to save memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.wheel_phase import WINDOW_DURATION

# rad/s; mean spin of a window below which the wheel stands.
_STANDING_SPIN = 0.5
# Windows per block of scores, longer than any remaining correlation.
BLOCK_WINDOWS = 8
# Blocks in one segment.
_SEGMENT_BLOCKS = 16


@dataclass(frozen=True)
class Segment:
    """Consecutive windows of a log, in whole blocks except in the last segment.

    window_starts: (K,) s
    samples: for each node its samples in the segment, at least one
    edges: for each node (K + 1,), its first sample in each window and the end, counted within the segment
    """

    window_starts: Array
    samples: Mapping[str, slice]
    edges: Mapping[str, NDArray[np.intp]]


def split_segments(problem: Problem) -> list[Segment]:
    """Split a log into segments."""
    grid = window_grid(problem)
    edges = {node.name: window_edges(grid, node) for node in problem.nodes}
    cuts = [0]
    for at in range(_SEGMENT_BLOCKS * BLOCK_WINDOWS, len(grid), _SEGMENT_BLOCKS * BLOCK_WINDOWS):
        # A node without samples in this segment is processed together with a neighbouring segment.
        if all(own[cuts[-1]] < own[at] < own[-1] for own in edges.values()):
            cuts.append(at)
    segments = []
    for first, end in zip(cuts, [*cuts[1:], len(grid)], strict=True):
        samples = {name: slice(int(own[first]), int(own[end])) for name, own in edges.items()}
        inside = {name: own[first : end + 1] - own[first] for name, own in edges.items()}
        segments.append(Segment(grid[first:end], samples, inside))
    return segments


def window_grid(problem: Problem) -> Array:
    """Return the start of each window, (K,) s."""
    first = min(node.t[0] for node in problem.nodes)
    last = max(node.t[-1] for node in problem.nodes)
    return np.arange(first, last, WINDOW_DURATION)


def window_edges(grid: Array, node: NodeData) -> NDArray[np.intp]:
    """Return the first sample of a node in each window, and the end, (K+1,)."""
    return np.append(np.searchsorted(node.t, grid), len(node.t))


def window_indices(grid: Array, t: Array) -> NDArray[np.intp]:
    """Return the window that contains each time, (N,)."""
    return np.clip(np.searchsorted(grid, t, side="right") - 1, 0, None)


def find_standing_windows(node: NodeData, edges: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return a mask of the windows, (K,), in which a wheel stands; nowhere for a node on the body."""
    spin = np.abs(node.y[2, : edges[-1]])
    return np.asarray(node.on_wheel & (window_means(spin, edges) < _STANDING_SPIN))


def window_means(value: Array, edges: NDArray[np.intp]) -> Array:
    """Return the mean in each window, (K,), interpolated over windows without samples."""
    count = np.diff(edges)
    total = np.diff(np.concatenate([[0.0], np.cumsum(value)])[edges])
    at = np.arange(len(count))
    return np.asarray(np.interp(at, at[count > 0], total[count > 0] / count[count > 0]))
