"""Held-out samples: segments with a driving condition that is not fitted, rather than a later part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.problem.problem import Problem
from hubodo.gap.process_noise.residual import Residual, SampleMasks, compute_gap
from hubodo.gap.process_noise.weights import Weights

# s; shares of all segments
_HELD_OUT_SEGMENT = 10.0
_MIN_HELD_OUT_SHARE, _MAX_HELD_OUT_SHARE = 0.15, 0.45
# s; longer than the vibration of a road is correlated, and at least four in a held-out segment.
_BLOCK_DURATION = 2.5
# Ratio of two sums of squares up to which they are equal: held-out samples may not show an effect at all.
_MAX_EQUAL_RATIO = 1.0002


@dataclass(frozen=True)
class HeldOutSplit:
    """A split of a log into fitted and held-out samples.

    masks: for each node (N,), True where held out
    kind: the held-out driving condition, in words
    """

    masks: SampleMasks
    kind: str

    def exclude_from(self, weights: Weights) -> Weights:
        """Return weights under which held-out samples do not affect a fit."""
        noise = {
            name: channel_noise.exclude(self.masks[name]) for name, channel_noise in weights.noise.items()
        }
        return replace(weights, noise=noise)


@dataclass(frozen=True)
class HeldOutResidual:
    """Residual of held-out samples under a fit to all others, in units of the declared noise.

    gap: rms
    block_squares: (B,) sum of squares in each block of time
    """

    gap: float
    block_squares: Array

    def is_larger_than(self, other: HeldOutResidual) -> bool:
        """Return True if the sum of squares is larger by more than 1 sigma of the scatter of its growth.

        The noise of roads is much larger during driving than at standstill. An effect that is determined at
        standstill changes the residual of driving by little, and noise decides whether that grows or shrinks.
        """
        growth, count = self.block_squares - other.block_squares, len(self.block_squares)
        sigma = float(np.std(growth)) * count / np.sqrt(max(count - 1, 1)) if count else 0.0
        equal = (_MAX_EQUAL_RATIO - 1.0) * float(other.block_squares.sum())
        return bool(growth.sum() > max(sigma, equal))


def measure_held_out(residuals: Mapping[str, Residual], masks: SampleMasks) -> HeldOutResidual:
    """Return the residual of the samples of `masks`."""
    first = min(float(one.node.t[0]) for one in residuals.values())
    last = max(float(one.node.t[-1]) for one in residuals.values())
    squares = np.zeros(1 + int((last - first) / _BLOCK_DURATION))
    for name, residual in residuals.items():
        for t, values in residual.list_squares(masks[name]):
            squares += np.bincount(((t - first) / _BLOCK_DURATION).astype(np.intp), values, len(squares))
    is_held_out = squares > 0.0
    return HeldOutResidual(compute_gap(residuals, masks), squares[is_held_out])


def split_held_out(problem: Problem) -> HeldOutSplit:
    """Hold out segments of ten seconds of one driving condition, by speed and yaw rate.

    If nothing varies in the log, every third segment is held out.
    """
    edges = np.arange(problem.nodes[0].t[0], problem.nodes[0].t[-1] + _HELD_OUT_SEGMENT, _HELD_OUT_SEGMENT)
    count = len(edges) - 1
    grid = np.linspace(edges[0], edges[-1], 20 * count, endpoint=False)
    body = problem.inputs.at(grid)
    speed = np.sqrt((body.speed**2).reshape(count, -1).mean(axis=1))
    turning = np.sqrt((body.yaw_rate**2).reshape(count, -1).mean(axis=1))
    conditions = {
        "fast with turns": (speed > np.median(speed)) & (turning > np.median(turning)),
        "slow with turns": (speed <= np.median(speed)) & (turning > np.median(turning)),
        "fast and straighter": (speed > np.median(speed)) & (turning <= np.median(turning)),
    }
    for description, is_chosen in conditions.items():
        if _MIN_HELD_OUT_SHARE <= is_chosen.mean() <= _MAX_HELD_OUT_SHARE and np.ptp(speed) > 0.05:
            return HeldOutSplit(
                _select_samples(problem, edges, is_chosen), f"stretches that are {description}"
            )
    third = np.arange(count) % 3 == 1
    return HeldOutSplit(_select_samples(problem, edges, third), "every third stretch of ten seconds")


def _select_samples(
    problem: Problem, edges: NDArray[np.float64], is_chosen: NDArray[np.bool_]
) -> SampleMasks:
    masks = {}
    for node in problem.nodes:
        segment = np.clip(np.searchsorted(edges, node.t, side="right") - 1, 0, len(is_chosen) - 1)
        masks[node.name] = is_chosen[segment]
    return masks
