"""Fixes against the way that the wheels rolled, before any heading is known: wrong sigmas, and jumps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.between import Complex

_SIGMAS = 6.0
"""Of the change between two fixes: chance goes beyond in one of 6e7."""
_STRETCH = 1.05
"""Times the way that the wheels say they rolled: a radius by tape measure, and a tyre's growth."""
_MOST_RUNS = 400
"""With more changes than that the sigmas are false, not the fixes; comparing all pairs would take long."""
_RAYLEIGH_MEDIAN = 1.1774
"""sqrt(2 ln 2), the median length of a pair of unit normals."""
_ENOUGH = 30
"""Fixes whose median change is known to an eighth."""
_BEYOND_CHANCE = 1.3
"""More than twice that eighth."""


def scatter(place: Complex, way: Array, sigma: Array) -> float:
    """How many times its sigma a fix is off, from the changes between successive fixes; at least 1.

    place: (M,) m; way: (M,) m rolled until then; sigma: (M,) m. The median length of a change of two white
    errors is 1.18 sqrt(2) sigma; the way in between is taken off. Less than 30 % beyond chance is left
    alone.
    """
    if len(place) < _ENOUGH:
        return 1.0
    free = np.maximum(np.abs(np.diff(place)) - np.diff(way), 0.0)
    size = float(np.median(free / np.hypot(sigma[1:], sigma[:-1]))) / _RAYLEIGH_MEDIAN
    return size if size > _BEYOND_CHANCE else 1.0


def without_jumps(place: Complex, way: Array, sigma: Array) -> NDArray[np.bool_]:
    """Which of the fixes, (M,), to keep: the most that never move further than the wheels rolled.

    A change beyond the way and six sigma of both fixes parts runs of fixes. Of the sequences of runs in
    which each can be reached from the one before it, the one with the most fixes is kept.
    """
    n = len(place)
    noise = _SIGMAS * np.hypot(sigma[1:], sigma[:-1])
    cuts = np.flatnonzero(np.abs(np.diff(place)) > _STRETCH * np.diff(way) + noise) + 1
    if len(cuts) == 0 or len(cuts) > _MOST_RUNS:
        return np.ones(n, np.bool_)
    first, last = np.append(0, cuts), np.append(cuts, n) - 1
    size = last - first + 1
    best, before = size.astype(np.float64), np.full(len(first), -1)
    for run in range(1, len(first)):
        reach = _STRETCH * (way[first[run]] - way[last[:run]])
        reach = reach + _SIGMAS * np.hypot(sigma[first[run]], sigma[last[:run]])
        near = np.abs(place[first[run]] - place[last[:run]]) <= reach
        total = np.where(near, best[:run], 0.0)
        chosen = int(np.argmax(total))
        if total[chosen] > 0.0:
            best[run] += total[chosen]
            before[run] = chosen
    keep = np.zeros(n, np.bool_)
    run = int(np.argmax(best))
    while run >= 0:
        keep[first[run] : last[run] + 1] = True
        run = int(before[run])
    return keep
