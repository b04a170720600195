"""What the data say about every direction at once, with what wanders at random taken out window by window.

The angle of a wheel is a random walk beside what the inputs say (their noise, integrated); so may be a gyro's
bias. In each window such a walk is one number. A Kalman filter carries it on, for the residual and for all
columns together, and what is left in each window is independent of the windows before it: quadratic forms
that simply add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hubodo.gap.wheel_phase import WINDOW, windows
from hubodo.model.frames import Array

# Residuals beyond this many times the noise, and beyond what is usual in their channel, count as that much.
_CLIP, _USUAL = 6.0, 8.0
_UNKNOWN = 1e2


@dataclass(frozen=True)
class Walk:
    """Something that wanders. answer: (6, N), change of the channels per unit. intensity: unit² per second.
    path: (N,) where it was thought to be when residual and columns were taken. start: variance at first."""

    answer: Array
    intensity: float
    path: Array
    start: float = _UNKNOWN


@dataclass(frozen=True)
class Innovations:
    """Of one node: t: (K,) s, middle of each window. grams: (K, P+1, P+1), the last row and column belong to
    the residual. logs: (K,) logarithms that go with them: -½ (last element + log) is the log-likelihood.
    raw: (P+1,) squares of the columns before anything was taken out."""

    t: Array
    grams: Array
    logs: Array
    raw: Array


def innovations(t: Array, made: Array, rest: Array, weight: Array, walks: Sequence[Walk]) -> Innovations:
    """t: (N,) s. made: (P, 6, N) columns. rest: (6, N) residual. weight: (6, N), one over sigma, 0 for
    samples that do not count."""
    edges = windows(t, WINDOW)
    size, count = len(made) + 1, len(walks)
    scaled = winsorised(rest * weight).astype(np.float32)
    light = weight.astype(np.float32)
    answers = np.stack([(walk.answer * weight).astype(np.float32) for walk in walks]) if walks else None
    width = np.diff(edges)
    middle = np.add.reduceat(t, edges[:-1]) / width
    paths = [np.add.reduceat(walk.path, edges[:-1]) / width for walk in walks]
    moves = np.diff(np.array(paths).reshape(count, -1), axis=1, prepend=0.0)
    steps = np.diff(middle, prepend=middle[0])
    intensity = np.diag([walk.intensity for walk in walks])
    known = np.zeros((count, size))
    variance = np.diag([walk.start for walk in walks])
    if count:
        moves[:, 0] = [
            0.0 if walk.start >= _UNKNOWN else path[0] for walk, path in zip(walks, paths, strict=True)
        ]
    grams, logs = np.empty((len(width), size, size)), np.zeros(len(width))
    raw = np.zeros(size)
    for k, (a, b) in enumerate(pairwise(edges)):
        block = np.concatenate(
            [(made[:, :, a:b] * light[:, a:b]).reshape(size - 1, 6 * (b - a)), scaled[:, a:b].reshape(1, -1)]
        )
        gram = (block @ block.T).astype(np.float64)
        raw += np.diag(gram)
        if answers is not None:
            here = answers[:, :, a:b].reshape(count, -1)
            g = (here @ here.T).astype(np.float64)
            m = (here @ block.T).astype(np.float64)
            # The residual was taken about the path: where that moves, the walk has to be paid for it.
            known[:, -1] -= moves[:, k]
            variance = variance + intensity * steps[k]
            u = m - g @ known
            spread = np.eye(count) + variance @ g
            gain = np.linalg.solve(spread, variance)
            cross = known.T @ m
            gram -= cross + cross.T - known.T @ g @ known + u.T @ gain @ u
            logs[k] = np.linalg.slogdet(spread)[1]
            known = known + gain @ u
            variance = gain
        grams[k] = gram
    return Innovations(middle, grams, logs, raw)


def winsorised(rest: Array) -> Array:
    """(6, N) residuals in sigma; wild ones pulled in, so that no sample decides alone."""
    usual = _USUAL * np.median(np.abs(rest), axis=1, keepdims=True)
    bound = np.maximum(_CLIP, usual)
    return np.clip(rest, -bound, bound)
