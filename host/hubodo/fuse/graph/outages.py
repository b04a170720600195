"""How far a track was off where fixes were missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.track import Track


@dataclass(frozen=True, slots=True)
class Outage:
    """A time without fixes.

    start, end: s, of the fixes before and after. distance: m driven in it. sigma: m, 1 sigma of the
    position at its end. error, percent: m and % of the distance there, worst: m within it; None without
    truth.
    """

    start: float
    end: float
    distance: float
    sigma: float
    error: float | None
    percent: float | None
    worst: float | None


def outages(
    track: Track, fix_t: Array, truth: tuple[Array, Array, Array] | None = None, longest: float = 10.0
) -> tuple[Outage, ...]:
    """Outages of more than `longest` seconds within a track.

    fix_t: (M,) s, fixes that counted. truth: t (s), x, y (m, (K,)) in axes of the track; it is shifted onto
    the track by the mean of both where there are fixes, never turned.
    """
    gaps = np.flatnonzero(np.diff(fix_t) > longest)
    dx = dy = None
    if truth is not None:
        dx = track.x - np.interp(track.t, truth[0], truth[1])
        dy = track.y - np.interp(track.t, truth[0], truth[2])
        known = (track.t >= truth[0][0]) & (track.t <= truth[0][-1])
        after = np.clip(np.searchsorted(fix_t, track.t), 1, len(fix_t) - 1)
        covered = known & (fix_t[after] - fix_t[after - 1] <= longest)
        covered = covered if covered.any() else known
        if covered.any():
            dx, dy = dx - dx[covered].mean(), dy - dy[covered].mean()
    found = []
    for gap in gaps:
        start, end = float(fix_t[gap]), float(fix_t[gap + 1])
        inside = np.flatnonzero((track.t >= start) & (track.t <= end))
        if len(inside) < 2:
            continue
        distance = float(np.hypot(np.diff(track.x[inside]), np.diff(track.y[inside])).sum())
        sigma = float(np.hypot(track.sigma_x[inside[-1]], track.sigma_y[inside[-1]]))
        error = percent = worst = None
        if dx is not None and dy is not None:
            off = np.hypot(dx[inside], dy[inside])
            error, worst = float(off[-1]), float(off.max())
            percent = 100.0 * error / distance if distance > 0.0 else None
        found.append(Outage(start, end, distance, sigma, error, percent, worst))
    return tuple(found)
