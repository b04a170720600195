"""Where a first guess of the poses comes from: the odometry's shape laid onto the fixes in stretches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factors.between import ComplexArray

_N_FIX_PAIRS = 64
"""Pairs of fixes tried in a stretch.

With half of all fixes false, one pair in four is of two sound ones, and all 64 fail in one stretch of 1e8.
"""
_MAX_TURN_SIGMA = 0.1
"""rad; 1 sigma of a stretch's turn: from there Gauss-Newton finds its way."""
_INLIER_SIGMAS = 3.0
"""Sigmas within which a fix agrees with a turn and shift."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """The odometry laid onto the fixes, at each of them.

    heading: (n,) rad to add to the odometry's heading at each fix. place: (n,) complex, m: the place of each
    fix by the odometry laid onto the fixes about it. found: whether any stretch was long enough to tell a
    heading.
    """

    turn: Array
    position: ComplexArray
    turn_observable: bool


def align_odometry(odometry: ComplexArray, fixes: ComplexArray, sigma: Array) -> Alignment:
    """Turn and shift of the odometry's places (n,) at the times of the fixes (n,), sigma (n,) m.

    Each stretch is as long as a turn known to 0.1 rad needs; in it the turn and shift that most fixes agree
    with are sought from pairs of fixes far apart (Fischler and Bolles 1981, with pairs drawn from a fixed
    sequence), then refined by least squares on those fixes (the closed form of the plane). So neither fixes
    that jumped nor a heading that drifted by whole turns in an hour mislead it.
    """
    n = len(odometry)
    turns, weights, centres, middles, targets = [], [], [], [], []
    begin = 0
    while begin < n:
        end = _find_section_end(odometry, sigma, begin)
        if n - end < (end - begin) // 2:
            end = n
        o, g = odometry[begin:end], fixes[begin:end]
        inside = _find_inliers(o, g, sigma[begin:end])
        if np.count_nonzero(inside) >= 2:
            o, g, s = o[inside], g[inside], sigma[begin:end][inside]
            share = s**-2.0
            mean_o, mean_g = np.average(o, weights=share), np.average(g, weights=share)
            product = np.sum(share * np.conj(o - mean_o) * (g - mean_g))
            turns.append(float(np.angle(product)))
            # Information on the turn is that of the fixes times their lever arms.
            weights.append(float(np.sum(share * np.abs(o - mean_o) ** 2)))
            centres.append(float(begin + np.flatnonzero(inside).mean()))
            middles.append(complex(mean_o))
            targets.append(complex(mean_g))
        begin = end
    telling = [index for index, weight in enumerate(weights) if weight > 1.0]
    if not telling:
        middle = complex(np.median(fixes.real), np.median(fixes.imag))
        centre = complex(np.median(odometry.real), np.median(odometry.imag))
        return Alignment(np.zeros(n), middle + odometry - centre, False)
    known = np.unwrap([turns[index] for index in telling])
    heading = np.interp(np.arange(n), [centres[index] for index in telling], known)
    nearest = np.abs(np.arange(n)[:, None] - np.array(centres)[None, :]).argmin(axis=1)
    place = np.array(targets)[nearest] + np.exp(1j * heading) * (odometry - np.array(middles)[nearest])
    return Alignment(heading, place, True)


def _find_section_end(odometry: ComplexArray, sigma: Array, begin: int) -> int:
    """The first end at which the turn is known well enough, searched in growing steps."""
    n, count = len(odometry), 8
    while begin + count < n:
        o = odometry[begin : begin + count]
        information = np.sum(np.abs(o - o.mean()) ** 2 / sigma[begin : begin + count] ** 2)
        if information > 1.0 / _MAX_TURN_SIGMA**2:
            return begin + count
        count = int(count * 1.5)
    return n


def _find_inliers(
    o: ComplexArray, g: ComplexArray, sigma: Array
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which fixes agree with the turn and shift that the most of them agree with."""
    n = len(o)
    if n < 3:
        return np.ones(n, np.bool_)
    # The golden section spreads pairs over the stretch without chance.
    first = (np.arange(1, _N_FIX_PAIRS + 1) * 0.6180339887 % 1.0 * n).astype(np.intp)
    second = (first + (0.25 + 0.5 * (np.arange(1, _N_FIX_PAIRS + 1) * 0.7548776662 % 1.0)) * n).astype(
        np.intp
    ) % n
    base, gap = o[second] - o[first], g[second] - g[first]
    turn = np.exp(1j * np.angle(gap * np.conj(base)))
    miss = np.abs(
        0.5 * (g[first] + g[second])[:, None]
        + turn[:, None] * (o[None, :] - 0.5 * (o[first] + o[second])[:, None])
        - g[None, :]
    )
    score = np.minimum((miss / sigma) ** 2, _INLIER_SIGMAS**2 * 2.0).sum(axis=1)
    inside = miss[int(np.argmin(score))] < 2.0 * _INLIER_SIGMAS * sigma
    for _ in range(3):
        if np.count_nonzero(inside) < 2:
            return np.ones(n, np.bool_)
        mean_o, mean_g = o[inside].mean(), g[inside].mean()
        turn_now = np.exp(1j * np.angle(np.sum(np.conj(o[inside] - mean_o) * (g[inside] - mean_g))))
        inside = np.abs(mean_g + turn_now * (o - mean_o) - g) < 1.5 * _INLIER_SIGMAS * sigma
    return np.asarray(inside) if np.count_nonzero(inside) >= 2 else np.ones(n, np.bool_)
