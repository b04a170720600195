"""What the data say about every direction at once, with what wanders at random taken out window by window.

The angle of a wheel is a random walk beside what the inputs say (their noise, integrated); so may be a gyro's
bias, or a clock. In each window such a walk is one number. A Kalman filter carries them on, for the residual
and for all columns together, and what is left in each window is independent of the windows before it:
quadratic forms that simply add up.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv

from hubodo.arrays import Array
from hubodo.gap.process_noise.symmetric import Symmetric
from hubodo.gap.process_noise.window_sums import UNKNOWN, Share, Sums, Walk, WindowSums


@dataclass(frozen=True)
class Innovations:
    """What the filter left of residuals and columns, as sums.

    grams: of P+1 each, one for each `block` windows; the last row and column belong to the residual.
    logs: logarithms that go with them: -½ (last element + logs) is the log-likelihood. raw: (P+1,)
    squares of the columns before anything but a free walk was taken out, with those of the steps that
    they ask of it. mean: (K, C) where each walk is beside its path as all windows show it; nothing when
    only columns were asked for.
    """

    grams: Symmetric
    logs: float
    raw: Array
    mean: Array


@dataclass(frozen=True)
class _Step:
    """The walks in one window: (C,) before it was seen, (C, C) its variance, and both after."""

    expected: Array
    wide: Array
    mean: Array
    variance: Array


def innovations(
    parts: Iterable[Iterable[Share]],
    walks: Sequence[Walk],
    paths: Array,
    size: int,
    window: float,
    block: int,
    smooth: bool = False,
    together: Array | float = 0.0,
) -> Innovations:
    """size: P columns in all. window: s. block: windows whose grams are added up. smooth: ask for `mean`.

    parts: of each stretch of time the shares of the nodes, whole blocks but in the last; each is asked for
    when the one before it has been summed up: not all need be there at once. paths: (C, K) where each walk
    was thought to be when residual and columns were taken. together: (C, C) covariance per second of the
    steps of different walks, zero on the diagonal.
    """
    nodes: list[WindowSums] = []
    moves = np.diff(paths, axis=1, prepend=0.0)
    start = np.array([walk.start for walk in walks])
    moves[:, 0] = np.where(start >= UNKNOWN, 0.0, paths[:, 0])
    filtered, first = _Filter(walks, size, window, smooth, together), 0
    grams = Symmetric.room(-(-paths.shape[1] // block), size + 1)
    for shares in parts:
        summed = []
        for k, share in enumerate(shares):
            if k == len(nodes):
                nodes.append(WindowSums(share, walks, size, window, block))
            summed.append((nodes[k], nodes[k].add(share)))
            del share
        windows = len(summed[0][1].cross)
        made = _taken(filtered, summed, moves[:, first : first + windows], block, size + 1)
        grams.put(first // block, made)
        first += windows
    raw = np.zeros(size + 1)
    for node in nodes:
        raw[node.at] += node.raw
    white = np.array([walk.white for walk in walks], bool)
    mean = _smoothed(filtered.steps, white, len(walks))
    return Innovations(grams, filtered.logs, raw, mean)


def _taken(
    filtered: _Filter, summed: Sequence[tuple[WindowSums, Sums]], moves: Array, block: int, size: int
) -> Array:
    """(B, P+1, P+1): the grams of one part. moves: (C, K) of the paths of the walks. size: P+1."""
    count, windows = moves.shape
    grams = np.zeros((-(-windows // block), size, size))
    shift, cross = np.zeros((2, windows, count, size))
    own = np.zeros((windows, count, count))
    for node, sums in summed:
        feels = node.feels[:, None]
        shift[:, node.feels[node.free][:, None], node.at[:-1]] += sums.shift
        cross[:, feels, node.at] += sums.cross
        own[:, feels, node.feels] += sums.own
        grams[:, node.at[:, None], node.at] += sums.squares
    # The residual was taken about the path: where that moves, the walk has to be paid for it.
    shift[:, :, -1] += moves.T
    return grams - filtered.take(cross, own, shift, block)


class _Filter:
    """The walks carried from window to window: (C, P+1), what they do for each column, and their variance."""

    def __init__(
        self, walks: Sequence[Walk], size: int, window: float, smooth: bool, together: Array | float
    ) -> None:
        white = np.array([walk.white for walk in walks], bool)
        start, count = np.array([walk.start for walk in walks]), len(walks)
        own = np.diag([0.0 if walk.white else walk.intensity for walk in walks])
        self._growth = (own + together) * window
        self._lasting, self._anew = np.outer(~white, ~white), np.diag(np.where(white, start, 0.0))
        self._carried = np.where(white, 0.0, 1.0)[:, None]
        self._known, self._variance = np.zeros((count, size + 1)), np.diag(start)
        self._smooth, self._begun = smooth, False
        self.logs, self.steps = 0.0, list[_Step]()

    def take(self, cross: Array, own: Array, shift: Array, block: int) -> Array:
        """(B, P+1, P+1): what the walks do, to be taken out of the products of each `block` windows.

        cross: (K, C, P+1), own: (K, C, C), shift: (K, C, P+1), as in `WindowSums`, of all nodes together.
        """
        one = np.eye(len(self._variance))
        left, right = np.empty((2, len(cross), 2, *self._known.shape))
        right[:, 0] = cross
        spreads = np.empty_like(own)
        after, variance = self._known, self._variance
        seen = zip(cross, own, shift, spreads, left, right, strict=True)
        for m, g, by, spread, (known, u), (_, to) in seen:
            np.subtract(after, by, out=known)
            known *= self._carried
            if self._begun:
                variance = (variance + self._growth) * self._lasting + self._anew
            self._begun = True
            np.subtract(m, g @ known, out=u)
            np.add(one, variance @ g, out=spread)
            gain = _solve(spread, variance)
            after = np.add(known, gain @ u, out=to)
            if self._smooth:
                self.steps.append(_Step(known[:, -1].copy(), variance, after[:, -1].copy(), gain))
            variance = gain
        self._known, self._variance = after.copy(), variance
        self.logs += float(np.linalg.slogdet(spreads)[1].sum())
        # known' m + m' known - known' g known + u' gain u, with u = m - g known.
        size, made = self._known.shape[1], []
        for at in range(0, len(cross), block):
            one = left[at : at + block].reshape(-1, size).T @ right[at : at + block].reshape(-1, size)
            made.append(0.5 * (one + one.T))
        return np.array(made)


def _solve(matrix: Array, right: Array) -> Array:
    """As `np.linalg.solve`, which for matrices as small as these takes four times as long."""
    if not len(matrix):
        return right
    _, _, made, info = dgesv(matrix, right)
    if info:
        raise np.linalg.LinAlgError("Singular matrix")
    return np.asarray(made)


def _smoothed(steps: Sequence[_Step], white: NDArray[np.bool_], count: int) -> Array:
    """(K, C): Rauch, Tung and Striebel's smoother (1965)."""
    made = np.empty((len(steps), count))
    for k in range(len(steps) - 1, -1, -1):
        made[k] = steps[k].mean
        if k + 1 < len(steps):
            ahead = steps[k + 1]
            size = np.sqrt(ahead.wide.diagonal())
            lead = (made[k + 1] - ahead.expected) / size
            lead = _solve(ahead.wide / (size[:, None] * size), lead) / size
            made[k] += steps[k].variance @ np.where(white, 0.0, lead)
    return made
