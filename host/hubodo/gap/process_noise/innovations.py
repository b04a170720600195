"""What the data say about every direction at once, with what wanders at random taken out window by window.

The angle of a wheel is a random walk beside what the inputs say (their noise, integrated); so may be a gyro's
bias, or a clock. In each window such a walk is one number. A Kalman filter carries them on, for the residual
and for all columns together, and what is left in each window is independent of the windows before it:
quadratic forms that simply add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

# Residuals beyond this many times the noise, and beyond what is usual in their channel, count as that much.
_CLIP, _USUAL = 6.0, 8.0
_UNKNOWN = 1e2
# What is left where a free walk does all that a column does is rounding: this share of its squares counts on.
_ROUNDED = 1e-6
# Numbers of one node that are looked at together: what is made of them stays in the processor's cache.
_AT_ONCE = 1 << 18


@dataclass(frozen=True)
class Walk:
    """Something that wanders. intensity: unit² per second. start: variance at first.

    white: it begins anew in each window, and `start` is its variance there.
    """

    intensity: float
    start: float = _UNKNOWN
    white: bool = False


@dataclass(frozen=True)
class Share:
    """What one node has to do with the columns and the walks.

    edges: (K+1,) its first sample in each window, and the end. columns: (P, 6, N). at: (P,) their places
    among all columns. residual: (6, N). weight: (6, N), one over sigma, 0 for samples that do not count.
    answers: (C, 6, N), change of the channels per unit of each walk it feels. feels: (C,) places of those.
    paths: (C, K) where each was thought to be when residual and columns were taken.
    """

    edges: NDArray[np.intp]
    columns: Array
    at: Sequence[int]
    residual: Array
    weight: Array
    answers: Array
    feels: Sequence[int]
    paths: Array


@dataclass(frozen=True)
class Innovations:
    """What the filter left of residuals and columns, as sums.

    grams: (B, P+1, P+1), one for each `block` windows; the last row and column belong to the residual.
    logs: logarithms that go with them: -½ (last element + logs) is the log-likelihood. raw: (P+1,)
    squares of the columns before anything but a free walk was taken out, with those of the steps that
    they ask of it. mean: (K, C) where each walk is beside its path as all windows show it; nothing when
    only columns were asked for.
    """

    grams: Array
    logs: float
    raw: Array
    mean: Array


class _Block:
    """The share of one node in a few windows, in units of the noise, one reading after the other."""

    def __init__(self, share: Share, walks: Sequence[Walk], size: int, window: float) -> None:
        self.share = share
        self.free = [k for k, place in enumerate(share.feels) if walks[place].start >= _UNKNOWN]
        felt = [walks[share.feels[k]] for k in self.free]
        self.growth = np.array([[walk.intensity * window] for walk in felt]).reshape(-1, 1)
        self.stripped = np.zeros((len(self.free), len(share.columns)))
        self.residual = winsorised(share.residual * share.weight)
        self.feels = np.array(share.feels, np.intp)
        self.count = len(share.columns) + 1
        self.at = np.array([*share.at, size])

    def enter(self, windows: range, raw: Array) -> None:
        """Go to these windows; raw: gets what stands in them, walks not yet taken out."""
        share, edges = self.share, self.share.edges[windows.start : windows.stop + 1]
        inside = slice(edges[0], edges[-1])
        weight = share.weight[:, inside]
        made = np.empty((weight.shape[1], 6, self.count + len(self.feels)), np.float32)
        made[:, :, : self.count - 1] = (share.columns[:, :, inside] * weight.astype(np.float32)).T
        made[:, :, self.count - 1] = self.residual[:, inside].T
        made[:, :, self.count :] = (share.answers[:, :, inside] * weight).T
        self.rows = made.reshape(-1, made.shape[2])
        whole = self.rows[:, : self.count - 1]
        raw[self.at[:-1]] += _ROUNDED * np.einsum("nk,nk->k", whole, whole)
        self.ends = 6 * (edges - inside.start)
        self.windows = [self.rows[start:end] for start, end in pairwise(self.ends)]
        self.moves = np.array([self._strip(window) for window in self.windows])
        if not windows.start:
            # Where a walk begins is free.
            self.moves[0] = 0.0

    def add_squares(self, windows: range, gram: Array, raw: Array) -> None:
        """Add what stands in some of the windows that were entered, counted from the first of those."""
        rows = self.rows[self.ends[windows.start] : self.ends[windows.stop], : self.count]
        squares = (rows.T @ rows).astype(np.float64)
        gram[np.ix_(self.at, self.at)] += squares
        raw[self.at] += np.diag(squares)

    def _strip(self, rows: NDArray[np.float32]) -> Array:
        """Take out of the columns of a window what a walk without bounds does for them.

        Gives how much further that is than before, (free, P). What a column turned a wheel by since the log
        began may be many turns: beside that, what tells it from the walk would drown in rounding.
        """
        before, columns = self.stripped.copy(), rows[:, : self.count - 1]
        for k, free in enumerate(self.free):
            answer = rows[:, self.count + free]
            power = float(answer @ answer)
            if power > 0.0 and columns.size:
                there = (answer @ columns).astype(float) / power
                columns -= answer[:, None] * there.astype(np.float32)
                self.stripped[k] = there
        return self.stripped - before

    def moved(self, shift: Array, raw: Array) -> None:
        """Add how far the columns moved with their free walks, window by window; shift: (K, C, P+1)."""
        shift[:, self.feels[self.free][:, None], self.at[:-1]] += self.moves
        raw[self.at[:-1]] += (self.moves**2 / self.growth).sum(axis=(0, 1))

    def add_answers(self, cross: Array, own: Array) -> None:
        """Add the products of the answers to the walks with the columns and each other, window by window.

        cross: (K, C, P+1). own: (K, C, C).
        """
        products = np.array([rows[:, self.count :].T @ rows for rows in self.windows])
        feels = self.feels[:, None]
        cross[:, feels, self.at] += products[:, :, : self.count]
        own[:, feels, self.feels] += products[:, :, self.count :]


@dataclass(frozen=True)
class _Step:
    """The walks in one window: (C,) before it was seen, (C, C) its variance, and both after."""

    expected: Array
    wide: Array
    mean: Array
    variance: Array


def innovations(
    shares: Sequence[Share], walks: Sequence[Walk], size: int, window: float, block: int, smooth: bool = False
) -> Innovations:
    """size: P columns in all. window: s. block: windows whose grams are added up. smooth: ask for `mean`."""
    nodes = [_Block(share, walks, size, window) for share in shares]
    windows, count = len(shares[0].edges) - 1, len(walks)
    paths = np.zeros((count, windows))
    for share, node in zip(shares, nodes, strict=True):
        paths[node.feels] = share.paths
    white = np.array([walk.white for walk in walks], bool)
    start = np.array([walk.start for walk in walks])
    growth = np.diag([0.0 if walk.white else walk.intensity * window for walk in walks])
    moves = np.diff(paths, axis=1, prepend=0.0)
    moves[:, 0] = np.where(start >= _UNKNOWN, 0.0, paths[:, 0])
    lasting, anew, one = np.outer(~white, ~white), np.diag(np.where(white, start, 0.0)), np.eye(count)
    carried = np.where(white, 0.0, 1.0)[:, None]
    known = np.zeros((count, size + 1))
    variance: Array = np.diag(start)
    grams, logs, raw = np.zeros((-(-windows // block), size + 1, size + 1)), 0.0, np.zeros(size + 1)
    steps: list[_Step] = []
    numbers = max(node.count * share.weight.size for share, node in zip(shares, nodes, strict=True))
    portion = block * max(1, _AT_ONCE * windows // (numbers * block))
    for first in range(0, windows, portion):
        inside = range(first, min(first + portion, windows))
        for node in nodes:
            node.enter(inside, raw)
        shift, cross = np.zeros((2, len(inside), count, size + 1))
        own = np.zeros((len(inside), count, count))
        for node in nodes:
            node.moved(shift, raw)
            node.add_answers(cross, own)
        # The residual was taken about the path: where that moves, the walk has to be paid for it.
        shift[:, :, -1] += moves[:, inside].T
        left, right, spreads = [], [], []
        for k, m, g, by in zip(inside, cross, own, shift, strict=True):
            known = (known - by) * carried
            if k:
                variance = (variance + growth) * lasting + anew
            u = m - g @ known
            spread = one + variance @ g
            gain = np.asarray(np.linalg.solve(spread, variance), float)
            after = known + gain @ u
            left.append([known, u])
            right.append([m, after])
            spreads.append(spread)
            if smooth:
                steps.append(_Step(known[:, -1], variance, after[:, -1], gain))
            known, variance = after, gain
        logs += float(np.linalg.slogdet(np.array(spreads))[1].sum())
        for at in range(0, len(inside), block):
            part, gram = slice(at, at + block), grams[(first + at) // block]
            for node in nodes:
                node.add_squares(range(at, min(at + block, len(inside))), gram, raw)
            # known' m + m' known - known' g known + u' gain u, with u = m - g known.
            taken = np.reshape(left[part], (-1, size + 1)).T @ np.reshape(right[part], (-1, size + 1))
            gram -= 0.5 * (taken + taken.T)
    return Innovations(grams, logs, raw, _smoothed(steps, white, count))


def _smoothed(steps: Sequence[_Step], white: NDArray[np.bool_], count: int) -> Array:
    """(K, C): Rauch, Tung and Striebel's smoother (1965)."""
    made = np.empty((len(steps), count))
    for k in range(len(steps) - 1, -1, -1):
        made[k] = steps[k].mean
        if k + 1 < len(steps):
            ahead = steps[k + 1]
            size = np.sqrt(np.diag(ahead.wide))
            lead = (made[k + 1] - ahead.expected) / size
            lead = np.linalg.solve(ahead.wide / np.outer(size, size), lead) / size
            made[k] += steps[k].variance @ np.where(white, 0.0, lead)
    return made


def winsorised(z: Array) -> Array:
    """(6, N) residuals in sigma; wild ones pulled in, so that no sample decides alone."""
    usual = _USUAL * np.median(np.abs(z), axis=1, keepdims=True)
    bound = np.maximum(_CLIP, usual)
    return np.clip(z, -bound, bound)
