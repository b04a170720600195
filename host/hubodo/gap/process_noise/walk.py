"""A random walk seen in noise: Kalman filter with its likelihood, and Rauch-Tung-Striebel smoother."""

from __future__ import annotations

from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from hubodo.arrays import Array

UNKNOWN = 1e6


@dataclass(frozen=True)
class Walked:
    """score: ln likelihood, up to a constant. mean, variance: (K,) filtered. innovation: (K,) in sigma."""

    score: float
    mean: Array
    variance: Array
    innovation: Array


def walked(seen: Array, variance: Array, steps: Array, intensity: float, start: float = UNKNOWN) -> Walked:
    """The walk behind values seen, (K,), with these variances, (K,).

    steps: (K-1,) s between them. intensity: unit² per second. start: variance about zero before the first.
    """
    x, v, score = 0.0, start, 0.0
    mean, spread, innovation = [], [], []
    growth = [0.0, *(intensity * steps).tolist()]
    for z, r, more in zip(seen.tolist(), variance.tolist(), growth, strict=True):
        v += more
        s = v + r
        off = z - x
        score -= 0.5 * (off * off / s + log(s))
        innovation.append(off / sqrt(s))
        x += v / s * off
        v *= r / s
        mean.append(x)
        spread.append(v)
    return Walked(score, np.array(mean), np.array(spread), np.array(innovation))


def scores(seen: Array, variance: Array, steps: Array, intensities: Array, starts: Array) -> Array:
    """(G,) the score of `walked` for each intensity, with its start."""
    x, v = np.zeros_like(intensities), starts.astype(float)
    growth = np.concatenate([[0.0], steps])[:, None] * intensities
    off, spread = np.empty_like(growth), np.empty_like(growth)
    for k, (z, r, more) in enumerate(zip(seen.tolist(), variance.tolist(), growth, strict=True)):
        v = v + more
        s = spread[k] = v + r
        ahead = off[k] = z - x
        share = v / s
        x = x + share * ahead
        v = share * r
    return np.asarray(-0.5 * (off**2 / spread + np.log(spread)).sum(axis=0))


def smoothed(walk: Walked, steps: Array, intensity: float) -> Array:
    """(K,) the walk as all values show it."""
    made = walk.mean.copy()
    for k in range(len(made) - 2, -1, -1):
        share = walk.variance[k] / (walk.variance[k] + intensity * steps[k])
        made[k] += share * (made[k + 1] - walk.mean[k])
    return made
