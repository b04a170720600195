"""GNSS fixes and headings as they stand in a log, to what the graph can use; what it cannot is said."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.factors.between import Complex
from hubodo.fuse.projection import FARTHEST, LocalFrame, local_frame

_FINEST = 0.005
_EDGE = 2.0
"""s; a receiver that runs a little longer than the wheels is nothing to speak of."""


@dataclass(frozen=True, eq=False)
class Fixes:
    """GNSS fixes, each (N,). t: s on the log's clock; sigma: m, 1 sigma of each horizontal direction, NaN
    or None where the receiver did not say."""

    t: Array
    latitude_deg: Array
    longitude_deg: Array
    sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class Headings:
    """Headings, each (N,). t: s; heading: rad, anticlockwise from east; sigma: rad or None."""

    t: Array
    heading: Array
    sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class LocalFixes:
    """Usable fixes, (M,). row: their numbers in the input; place: east + i north of the frame, m; warnings:
    one line for each reason why others are missing."""

    row: NDArray[np.intp]
    t: Array
    place: Complex
    sigma: Array
    frame: LocalFrame
    warnings: tuple[str, ...]


def usable_fixes(fixes: Fixes, begin: float, end: float, sigma: float, declared: bool) -> LocalFixes:
    """Fixes between two times, in a frame at their median.

    sigma: m, for fixes that do not say, or for all of them when `declared` is false. Raises InputError when
    none is usable: for the reason that most rows share.
    """
    if len(fixes.t) == 0:
        raise InputError("gnss: no fix in it; leave it out, or check the receiver")
    warnings: list[str] = []
    latitude, longitude = np.asarray(fixes.latitude_deg), np.asarray(fixes.longitude_deg)
    on_earth = np.isfinite(latitude) & np.isfinite(longitude) & (np.abs(latitude) <= 90.0)
    on_earth &= np.abs(np.where(np.isfinite(longitude), longitude, 0.0)) <= 360.0
    _say(
        warnings,
        fixes,
        ~on_earth,
        "are no place on Earth (latitude beyond 90 or longitude beyond 360 degrees)",
    )
    in_time = (fixes.t >= begin) & (fixes.t <= end)
    _say(
        warnings,
        fixes,
        on_earth & ((fixes.t < begin - _EDGE) | (fixes.t > end + _EDGE)),
        f"lie outside the odometry ({begin:.3f} to {end:.3f} s); if all do, the clocks differ",
    )
    keep = np.flatnonzero(on_earth & in_time)
    if len(keep) == 0:
        why = "; ".join(warnings) or "all lie outside the odometry's time"
        raise InputError(f"gnss: no usable fix: {why}; correct it or leave it out")
    first = longitude[keep[0]]
    around = (longitude[keep] - first + 180.0) % 360.0 - 180.0
    frame = local_frame(float(np.median(latitude[keep])), float(first + np.median(around)))
    x, y = frame.to_local(latitude[keep], longitude[keep])
    near = np.isfinite(x) & np.isfinite(y)
    near &= np.hypot(np.where(near, x, 0.0), np.where(near, y, 0.0)) < FARTHEST
    far = np.zeros(len(fixes.t), np.bool_)
    far[keep[~near]] = True
    _say(warnings, fixes, far, f"lie more than {FARTHEST / 1000.0:.0f} km from the others")
    keep, x, y = keep[near], x[near], y[near]
    own = np.full(len(fixes.t), np.nan) if fixes.sigma is None or not declared else np.asarray(fixes.sigma)
    own = own[keep]
    known = np.isfinite(own) & (own > 0.0)
    own = np.maximum(np.where(known, own, sigma), _FINEST)
    return LocalFixes(keep, np.asarray(fixes.t)[keep], x + 1j * y, own, frame, tuple(warnings))


def _say(warnings: list[str], fixes: Fixes, bad: NDArray[np.bool_], why: str) -> None:
    rows = np.flatnonzero(bad)
    if len(rows) > 0:
        warnings.append(
            f"gnss: {len(rows)} of {len(bad)} fixes left out, the first in row {rows[0] + 1} "
            f"(t = {fixes.t[rows[0]]:.3f} s): they {why}"
        )


def headings_at(
    headings: Headings, state_t: Array, path_t: Array, path_heading: Array, sigma: float
) -> tuple[NDArray[np.intp], Array, Array]:
    """Headings carried to the nearest pose by the odometry's own turning, one for each pose that has any.

    state_t: (n,) s; path_t, path_heading: (P,) the odometry, heading in rad, unwrapped. Returns pose,
    heading, 1 sigma; readings of one pose are averaged and count as one, for a compass errs alike for
    longer than a second.
    """
    after = np.clip(np.searchsorted(state_t, headings.t), 1, len(state_t) - 1)
    nearest = after - (headings.t - state_t[after - 1] < state_t[after] - headings.t)
    use = (headings.t >= state_t[0]) & (headings.t <= state_t[-1]) & np.isfinite(headings.heading)
    turned = np.interp(headings.t, path_t, path_heading) - np.interp(state_t[nearest], path_t, path_heading)
    pose, inverse = np.unique(nearest[use], return_inverse=True)
    total = np.zeros(len(pose), np.complex128)
    np.add.at(total, inverse, np.exp(1j * (headings.heading - turned))[use])
    own = np.full(len(headings.t), np.nan) if headings.sigma is None else np.asarray(headings.sigma)
    own = np.where(np.isfinite(own) & (own > 0.0), own, sigma)[use]
    least = np.full(len(pose), np.inf)
    np.minimum.at(least, inverse, own)
    return pose.astype(np.intp), np.angle(total), np.maximum(least, 1e-4)
