"""What one node read in each window, and its columns, as the sums that a filter of walks needs of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

# Residuals beyond this many times the noise, and beyond what is usual in their channel, count as that much.
_CLIP, _USUAL = 6.0, 8.0
UNKNOWN = 1e2
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
    start: float = UNKNOWN
    white: bool = False


@dataclass(frozen=True)
class Share:
    """What one node has to do with the columns and the walks, in a stretch of time.

    edges: (K+1,) its first sample in each window, and the end. columns: (P, 6, N). at: (P,) their places
    among all columns. z: (6, N) residuals in sigma, wild ones pulled in. weight: (6, N), one over sigma, 0
    for samples that do not count. answers: (C, 6, N), change of the channels per unit of each walk it feels.
    feels: (C,) places of those.
    """

    edges: NDArray[np.intp]
    columns: NDArray[np.float32]
    at: Sequence[int]
    z: Array
    weight: Array
    answers: Array
    feels: Sequence[int]


@dataclass(frozen=True)
class Sums:
    """Of one stretch of time of one node.

    cross: (K, C, P+1), products of the answers to the walks with the columns; own: (K, C, C), with each
    other. shift: (K, free, P), how far the columns moved with their `free` walks. squares: (B, P+1, P+1),
    products of the columns, for each `block` windows.
    """

    cross: Array
    own: Array
    shift: Array
    squares: Array


class WindowSums:
    """What a filter needs of one node, in units of the noise; its columns and readings may go.

    feels: (C,) places of the walks it feels; free: which of these have no bounds. at: (P+1,) places of its
    columns and the residual among all. raw: (P+1,) as in `Innovations`.
    """

    def __init__(self, share: Share, walks: Sequence[Walk], size: int, window: float, block: int) -> None:
        count = len(share.at) + 1
        self.feels, self.at = np.array(share.feels, np.intp), np.array([*share.at, size])
        self.free = [k for k, place in enumerate(share.feels) if walks[place].start >= UNKNOWN]
        self.raw = np.zeros(count)
        self._growth = np.array([walks[share.feels[k]].intensity * window for k in self.free])
        # Where the free walks were when the last window ended.
        self._stripped = np.zeros((len(self.free), count - 1))
        self._block, self._begun = block, False

    def add(self, share: Share) -> Sums:
        """The sums of the next stretch of time."""
        windows, count, answers = len(share.edges) - 1, len(share.at) + 1, len(share.feels)
        cross, own = np.zeros((windows, answers, count)), np.zeros((windows, answers, answers))
        shift = np.zeros((windows, len(self.free), count - 1))
        squares = np.zeros((-(-windows // self._block), count, count))
        for inside, rows in self._portions(share, self._block):
            whole = rows[:, :, : count - 1]
            self.raw[:-1] += _ROUNDED * np.einsum("wnk,wnk->k", whole, whole)
            for k, free in enumerate(self.free):
                there = _there(whole, rows[:, :, count + free], self._stripped[k])
                shift[inside, k] = np.diff(there, axis=0, prepend=self._stripped[k : k + 1])
                self._stripped[k] = there[-1]
            products = rows[:, :, count:].transpose(0, 2, 1) @ rows
            cross[inside], own[inside] = products[:, :, :count], products[:, :, count:]
            for first in range(0, len(rows), self._block):
                part = rows[first : first + self._block].reshape(-1, rows.shape[2])[:, :count]
                squares[(inside.start + first) // self._block] = part.T @ part
        if not self._begun:
            # Where a walk begins is free.
            shift[0] = 0.0
        self._begun = True
        self.raw += np.einsum("bkk->k", squares)
        self.raw[:-1] += (shift**2 / self._growth[:, None]).sum(axis=(0, 1))
        return Sums(cross, own, shift, squares)

    def _portions(self, share: Share, block: int) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Some windows at a time, and what stands in them, (W, 6 M, P+1+C); zeros where samples lack."""
        counts = np.diff(share.edges)
        windows, most = len(counts), int(counts.max(initial=1))
        width = len(share.columns) + 1 + len(share.feels)
        portion = block * max(1, _AT_ONCE // (6 * most * width * block))
        for first in range(0, windows, portion):
            inside = slice(first, min(first + portion, windows))
            samples = slice(share.edges[inside.start], share.edges[inside.stop])
            rows = _rows(share, samples)
            if (counts[inside] != most).any():
                there = np.arange(most) < counts[inside, None]
                padded = np.zeros((*there.shape, *rows.shape[1:]), np.float32)
                padded[there] = rows
                rows = padded
            yield inside, rows.reshape(inside.stop - inside.start, 6 * most, width)


def _rows(share: Share, samples: slice) -> NDArray[np.float32]:
    """(n, 6, P+1+C): columns, residual and answers of some samples, in units of the noise."""
    weight, count = share.weight[:, samples], len(share.columns)
    rows = np.empty((weight.shape[1], 6, count + 1 + len(share.feels)), np.float32)
    rows[:, :, :count] = (share.columns[:, :, samples] * weight.astype(np.float32)).T
    rows[:, :, count] = share.z[:, samples].T
    rows[:, :, count + 1 :] = (share.answers[:, :, samples] * weight).T
    return rows


def _there(columns: NDArray[np.float32], answer: NDArray[np.float32], before: Array) -> Array:
    """Take out of the columns, (W, M, P), what a walk without bounds does for them; answer: (W, M) to it.

    Gives where that walk is in each window, (W, P): where nothing tells, as in the window before, `before` at
    first. What a column turned a wheel by since the log began may be many turns: beside that, what tells it
    from the walk would drown in rounding.
    """
    power = np.einsum("wm,wm->w", answer, answer).astype(float)
    felt = power > 0.0
    there = (answer[:, None, :] @ columns)[:, 0].astype(float)
    there[felt] /= power[felt, None]
    last = np.maximum.accumulate(np.where(felt, np.arange(len(felt)), -1))
    there = np.where(last[:, None] >= 0, there[last], before)
    columns -= answer[:, :, None] * there[:, None, :].astype(np.float32)
    return there


def winsorised(z: Array) -> Array:
    """(6, N) residuals in sigma; wild ones pulled in, so that no sample decides alone."""
    bound = bounds(z)
    return np.clip(z, -bound, bound)


def bounds(z: Array) -> Array:
    """(6, 1) beyond which residuals in sigma, (6, N), are wild."""
    return np.array([[_bound(np.abs(row))] for row in z])


def _bound(size: Array) -> float:
    # Where most are small their median, which takes long, would not be asked.
    if 2 * np.count_nonzero(size <= _CLIP / _USUAL) > len(size):
        return _CLIP
    return max(_CLIP, _USUAL * float(np.median(size)))
