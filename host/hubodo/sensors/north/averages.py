"""A record on a table as averages over short intervals: all that the likelihood of north looks at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hubodo.arrays import Array

_SQUEEZED = 0.5
"""Of the time that its samples take: an interval whose stamps say less was stamped wrongly."""


@dataclass(frozen=True)
class Averages:
    """M averages in order of time, none before the one in front of it has ended.

    start, end: (M,) s. y: (M,) rad/s. cos, sin: (M,) means over each interval of those of the sensing axis's
    angle. turned: (M,) rad by which the table has turned since its first stop, as the gyro felt it; zero
    where angles are not the gyro's.
    """

    start: Array
    end: Array
    y: Array
    cos: Array
    sin: Array
    turned: Array

    def columns(self, scale: float) -> Array:
        """(M, 5): cos, sin, their derivatives by the error of the gyro's scale, y; at that error `scale`.

        A turn that was felt as `turned` was (1 + scale) times as large.
        """
        turn = scale * self.turned
        cos = self.cos * np.cos(turn) - self.sin * np.sin(turn)
        sin = self.sin * np.cos(turn) + self.cos * np.sin(turn)
        return np.column_stack([cos, sin, -self.turned * sin, self.turned * cos, self.y])

    def part(self, a: int, b: int) -> Averages:
        """Those from a on, before b."""
        fields = (self.start, self.end, self.y, self.cos, self.sin, self.turned)
        return Averages(*(values[a:b] for values in fields))


def average(
    t: Array,
    y: Array,
    angle: Array,
    spans: Sequence[tuple[int, int]],
    length: float,
    turned: Array | None = None,
) -> Averages:
    """Averages over equal parts, of about `length` s, of each span of samples [i, j).

    t: (N,) s. y: (N,) rad/s. angle: (N,) rad, of the sensing axis. turned: (N,) rad as in `Averages`. A part
    is left out whose samples stand so close that they cannot have been taken then, as a computer stamps them
    that made a node wait.
    """
    step = float(np.median(np.diff(t)))
    rows = []
    for i, j in spans:
        count = max(1, round((j - i) * step / length))
        edges = np.linspace(i, j, count + 1).round().astype(int)
        for a, b in pairwise(edges):
            # A step behind its last sample, but not behind the next: what drifts in intervals that overlap
            # would have no covariance.
            end = min(t[b - 1] + step, t[b]) if b < len(t) else t[b - 1] + step
            if end - t[a] > _SQUEEZED * (b - a) * step:
                part = angle[a:b]
                by = 0.0 if turned is None else turned[a]
                rows.append((t[a], end, y[a:b].mean(), np.cos(part).mean(), np.sin(part).mean(), by))
    return Averages(*np.array(rows).reshape(-1, 6).T)
