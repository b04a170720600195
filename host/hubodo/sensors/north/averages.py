"""Averages of a turntable record over short intervals, the data of the north likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hubodo.arrays import Array

_MIN_DURATION_SHARE = 0.5
"""Intervals shorter than this share of their nominal duration have wrong time stamps and are dropped."""


@dataclass(frozen=True)
class Averages:
    """M averages over successive, non-overlapping intervals.

    Attributes:
        start, end: (M,) limits of each interval, s.
        y: (M,) mean rate, rad/s.
        cos, sin: (M,) means of cosine and sine of the sensing axis's angle.
        turned: (M,) rotation since the first stop as measured by the gyro, rad; zero if the table gave the
            angles.
        temperature: (M,) mean temperatures, °C, or None.
    """

    start: Array
    end: Array
    y: Array
    cos: Array
    sin: Array
    turned: Array
    temperature: Array | None = None

    def design_columns(self, scale: float) -> Array:
        """Return the (M, 5) columns cos, sin, their derivatives by the gyro's scale error, and y.

        scale: scale error at which they are evaluated; the true rotation is (1 + scale) times `turned`.
        """
        rotation = scale * self.turned
        cos = self.cos * np.cos(rotation) - self.sin * np.sin(rotation)
        sin = self.sin * np.cos(rotation) + self.cos * np.sin(rotation)
        return np.column_stack([cos, sin, -self.turned * sin, self.turned * cos, self.y])

    def slice_rows(self, a: int, b: int) -> Averages:
        """Return the averages from index a to b - 1."""
        fields = (self.start, self.end, self.y, self.cos, self.sin, self.turned)
        rows = Averages(*(values[a:b] for values in fields))
        return rows if self.temperature is None else replace(rows, temperature=self.temperature[a:b])


def average_spans(
    t: Array,
    y: Array,
    angle: Array,
    spans: Sequence[tuple[int, int]],
    length: float,
    turned: Array | None = None,
    temperature: Array | None = None,
) -> Averages:
    """Return averages over equal parts, about `length` s long, of each span of samples [i, j).

    t: (N,) s. y: (N,) rad/s. angle: (N,) of the sensing axis, rad. turned: (N,) rad as in `Averages`.
    temperature: (N,) °C.
    Parts whose time stamps are closer than the sample rate allows are dropped: the computer received these
        samples late.
    """
    step = float(np.median(np.diff(t)))
    rows = []
    for i, j in spans:
        count = max(1, round((j - i) * step / length))
        edges = np.linspace(i, j, count + 1).round().astype(int)
        for a, b in pairwise(edges):
            # The interval ends one step after its last sample, but not after the next sample, because the
            # drift covariance is defined for non-overlapping intervals only.
            end = min(t[b - 1] + step, t[b]) if b < len(t) else t[b - 1] + step
            if end - t[a] > _MIN_DURATION_SHARE * (b - a) * step:
                angles = angle[a:b]
                rotation = 0.0 if turned is None else turned[a]
                degrees = 0.0 if temperature is None else temperature[a:b].mean()
                rows.append(
                    (
                        t[a],
                        end,
                        y[a:b].mean(),
                        np.cos(angles).mean(),
                        np.sin(angles).mean(),
                        rotation,
                        degrees,
                    )
                )
    start, end, means, cos, sin, rotations, warmth = np.array(rows).reshape(-1, 7).T
    return Averages(start, end, means, cos, sin, rotations, None if temperature is None else warmth)
