"""GNSS fixes as they stand in a log, to what the graph can use; what it cannot is said."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.between import ComplexArray
from hubodo.fuse.graph.factors.factor import find_runs
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.odometry_steps import SegmentedOdometry
from hubodo.fuse.projection import MAX_DISTANCE_FROM_ORIGIN, LocalFrame, make_local_frame
from hubodo.fuse.track import Track

_MIN_POSITION_SIGMA = 0.005
"""m; the centre of an antenna is no better known, whatever a receiver says."""
_OFF_GRID_DISTANCE = 1e7
"""m; a fix beyond the grid is a quarter of the way round the Earth, for a loss to refuse."""
_MAX_TIME_OVERHANG = 2.0
"""s; a receiver that runs a little longer than the wheels is nothing to speak of."""
_JUMP_SIGMAS = 6.0
"""Of the change between two fixes: chance goes beyond in one of 6e7."""
_MAX_DISTANCE_RATIO = 1.05
"""Times the way that the wheels say they rolled: a radius by tape measure, and a tyre's growth."""
_MAX_RUNS = 400
"""With more changes than that the sigmas are false, not the fixes; comparing all pairs would take long."""
_RAYLEIGH_MEDIAN = 1.1774
"""sqrt(2 ln 2), the median length of a pair of unit normals."""
_MIN_FIXES_FOR_SCATTER = 30
"""Fixes whose median change is known to an eighth."""
_MIN_SCATTER = 1.3
"""More than twice that eighth."""


@dataclass(frozen=True, eq=False)
class Fixes:
    """GNSS fixes, each (N,).

    t: s on the log's clock; sigma: m, 1 sigma of each horizontal direction, NaN or None where the receiver
    did not say.
    """

    t: Array
    latitude_deg: Array
    longitude_deg: Array
    sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class LocalFixes:
    """Usable fixes, (M,).

    row: their numbers in the input; place: east + i north of the frame, m; warnings: one line for each
    reason why others are missing.
    """

    input_row: NDArray[np.intp]
    t: Array
    position: ComplexArray
    sigma: Array
    frame: LocalFrame
    warnings: tuple[str, ...] = ()

    @property
    def pose_times(self) -> Array:
        """A pose stands at each fix."""
        return self.t

    def build_factors(self, cut: SegmentedOdometry, config: GraphConfig) -> PositionFactors:
        """One for each fix; the times must be among those of the poses."""
        state = np.searchsorted(cut.pose_t, self.t)
        place = np.column_stack([self.position.real, self.position.imag])
        return PositionFactors(state, place, self.sigma, cut.velocity[state], config.antenna)

    def select(self, keep: NDArray[np.bool_]) -> LocalFixes:
        """Those with a flag that is set."""
        own = (self.input_row[keep], self.t[keep], self.position[keep], self.sigma[keep])
        return LocalFixes(*own, self.frame, self.warnings)


def localise_fix(fix: Fixes, frame: LocalFrame, config: GraphConfig, sigma_growth: float) -> LocalFixes:
    """A fix as it comes, in a frame that stands. growth: times which its sigma is widened."""
    own = math.nan if fix.sigma is None else float(fix.sigma[0])
    sigma = own if config.use_declared_sigmas and math.isfinite(own) and own > 0.0 else config.gnss_sigma
    x, y = frame.to_local(fix.latitude_deg, fix.longitude_deg)
    place = np.nan_to_num(x, posinf=_OFF_GRID_DISTANCE, neginf=-_OFF_GRID_DISTANCE) + 1j * np.nan_to_num(
        y, posinf=_OFF_GRID_DISTANCE, neginf=-_OFF_GRID_DISTANCE
    )
    return LocalFixes(
        np.zeros(1, np.intp), fix.t, place, np.array([max(sigma, _MIN_POSITION_SIGMA) * sigma_growth]), frame
    )


def localise_fixes(fixes: Fixes, begin: float, end: float, sigma: float, declared: bool) -> LocalFixes:
    """Fixes between two times, in a frame at their median.

    sigma: m, for fixes that do not say, or for all of them when `declared` is false. Raises InputError when
    none is usable: for the reason that most rows share.
    """
    if len(fixes.t) == 0:
        raise InputError("gnss: no fix in it; leave it out, or check the receiver")
    warnings: list[str] = []
    latitude, longitude = np.asarray(fixes.latitude_deg), np.asarray(fixes.longitude_deg)
    # What is not finite is within no bound.
    on_earth = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 360.0)
    _add_warning(
        warnings,
        fixes,
        ~on_earth,
        "are no place on Earth (latitude beyond 90 or longitude beyond 360 degrees)",
    )
    in_time = (fixes.t >= begin) & (fixes.t <= end)
    _add_warning(
        warnings,
        fixes,
        on_earth & ((fixes.t < begin - _MAX_TIME_OVERHANG) | (fixes.t > end + _MAX_TIME_OVERHANG)),
        f"lie outside the odometry ({begin:.3f} to {end:.3f} s); if all do, the clocks differ",
    )
    keep = np.flatnonzero(on_earth & in_time)
    if len(keep) == 0:
        why = "; ".join(warnings) or "all lie outside the odometry's time"
        raise InputError(f"gnss: no usable fix: {why}; correct it or leave it out")
    first = longitude[keep[0]]
    around = (longitude[keep] - first + 180.0) % 360.0 - 180.0
    frame = make_local_frame(float(np.median(latitude[keep])), float(first + np.median(around)))
    x, y = frame.to_local(latitude[keep], longitude[keep])
    near = np.hypot(x, y) < MAX_DISTANCE_FROM_ORIGIN
    far = np.zeros(len(fixes.t), np.bool_)
    far[keep[~near]] = True
    _add_warning(
        warnings, fixes, far, f"lie more than {MAX_DISTANCE_FROM_ORIGIN / 1000.0:.0f} km from the others"
    )
    keep, x, y = keep[near], x[near], y[near]
    own = np.full(len(fixes.t), np.nan) if fixes.sigma is None or not declared else np.asarray(fixes.sigma)
    own = own[keep]
    known = np.isfinite(own) & (own > 0.0)
    own = np.maximum(np.where(known, own, sigma), _MIN_POSITION_SIGMA)
    return LocalFixes(keep, np.asarray(fixes.t)[keep], x + 1j * y, own, frame, tuple(warnings))


def _add_warning(warnings: list[str], fixes: Fixes, bad: NDArray[np.bool_], why: str) -> None:
    rows = np.flatnonzero(bad)
    if len(rows) > 0:
        warnings.append(
            f"gnss: {len(rows)} of {len(bad)} fixes left out, the first in row {rows[0] + 1} "
            f"(t = {fixes.t[rows[0]]:.3f} s): they {why}"
        )


def screen_fixes(path: Track, local: LocalFixes) -> tuple[LocalFixes, float, list[str]]:
    """The fixes that did not jump further than the wheels rolled, with sigmas that their scatter bears out.

    Besides, by what the sigmas grew, and what is to be said.
    """
    rolled = np.append(0.0, np.cumsum(np.hypot(np.diff(path.x), np.diff(path.y))))
    way = np.interp(local.t, path.t, rolled)
    said = []
    size = estimate_scatter(local.position, way, local.sigma)
    if size > 1.0:
        local = replace(local, sigma=local.sigma * size)
        said.append(f"gnss: the fixes scatter {size:.1f} times as much as their sigma says; it was widened")
    keep = find_consistent_fixes(local.position, way, local.sigma)
    for first, last in find_runs(~keep):
        before = max(first - 1, 0) if first > 0 else last + 1
        jump = float(np.abs(local.position[first] - local.position[before]))
        said.append(
            f"gnss: {last - first + 1} fixes from t = {local.t[first]:.1f} to {local.t[last]:.1f} s "
            f"jumped, by {jump:.0f} m; left out"
        )
    return local.select(keep), size, said


def estimate_scatter(place: ComplexArray, way: Array, sigma: Array) -> float:
    """How many times its sigma a fix is off, from the changes between successive fixes; at least 1.

    place: (M,) m; way: (M,) m rolled until then; sigma: (M,) m. The median length of a change of two white
    errors is 1.18 sqrt(2) sigma; the way in between is taken off. Less than 30 % beyond chance is left
    alone.
    """
    if len(place) < _MIN_FIXES_FOR_SCATTER:
        return 1.0
    free = np.maximum(np.abs(np.diff(place)) - np.diff(way), 0.0)
    size = float(np.median(free / np.hypot(sigma[1:], sigma[:-1]))) / _RAYLEIGH_MEDIAN
    return size if size > _MIN_SCATTER else 1.0


def find_consistent_fixes(place: ComplexArray, way: Array, sigma: Array) -> NDArray[np.bool_]:
    """Which of the fixes, (M,), to keep: the most that never move further than the wheels rolled.

    A change beyond the way and six sigma of both fixes parts runs of fixes. Of the sequences of runs in
    which each can be reached from the one before it, the one with the most fixes is kept.
    """
    n = len(place)
    noise = _JUMP_SIGMAS * np.hypot(sigma[1:], sigma[:-1])
    cuts = np.flatnonzero(np.abs(np.diff(place)) > _MAX_DISTANCE_RATIO * np.diff(way) + noise) + 1
    if len(cuts) == 0 or len(cuts) > _MAX_RUNS:
        return np.ones(n, np.bool_)
    first, last = np.append(0, cuts), np.append(cuts, n) - 1
    size = last - first + 1
    best, before = size.astype(np.float64), np.full(len(first), -1)
    for run in range(1, len(first)):
        reach = _MAX_DISTANCE_RATIO * (way[first[run]] - way[last[:run]])
        reach = reach + _JUMP_SIGMAS * np.hypot(sigma[first[run]], sigma[last[:run]])
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
