"""GNSS fixes of a log, screened and projected to a local frame; every rejection is reported."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.between import ComplexArray
from hubodo.fuse.graph.factors.factor import find_bridged_runs
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.odometry_steps import SegmentedOdometry
from hubodo.fuse.projection import MAX_DISTANCE_FROM_ORIGIN, LocalFrame, make_local_frame
from hubodo.fuse.track import Track

_MIN_POSITION_SIGMA = 0.005
"""m; the phase centre of an antenna is no better known, whatever a receiver declares."""
_OFF_GRID_DISTANCE = 1e7
"""m; stands for a fix beyond the grid, so that the robust loss rejects it."""
_MAX_TIME_OVERHANG = 2.0
"""s; a receiver that starts or ends that much outside the odometry is not reported."""
_JUMP_SIGMAS = 6.0
"""Sigmas of the change between two fixes; random errors exceed them in one of 6e7."""
_MAX_DISTANCE_RATIO = 1.05
"""Actual distance over that of the wheels: a radius by tape measure, and growth of a tyre."""
_MAX_RUNS = 400
"""Runs between jumps; more indicate wrong sigmas, not wrong fixes, and all pairs would take long."""
_RAYLEIGH_MEDIAN = 1.1774
"""sqrt(2 ln 2), the median norm of a pair of standard normal variables."""
_MIN_FIXES_FOR_SCATTER = 30
"""Fixes; the median change of this many has a standard deviation of an eighth."""
_MIN_SCATTER = 1.3
"""Ratio of scatter to sigma; the excess is more than twice the standard deviation of the median change."""


@dataclass(frozen=True, eq=False)
class Fixes:
    """GNSS fixes as logged, each (N,).

    Attributes
    ----------
    t : s on the log's clock.
    latitude_deg, longitude_deg : degrees.
    sigma : m, 1 sigma of each horizontal direction; NaN or None where the receiver declares none.
    """

    t: Array
    latitude_deg: Array
    longitude_deg: Array
    sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class LocalFixes:
    """Usable fixes in a local frame, each (M,).

    Attributes
    ----------
    input_row : their rows in the input.
    t : s on the log's clock.
    position : east + i north of the frame, m.
    sigma : m, of each direction.
    frame : the local frame.
    warnings : one line for each reason for which fixes were rejected.
    """

    input_row: NDArray[np.intp]
    t: Array
    position: ComplexArray
    sigma: Array
    frame: LocalFrame
    warnings: tuple[str, ...] = ()

    @property
    def pose_times(self) -> Array:
        """Return the times of all fixes: the graph has a pose at each."""
        return self.t

    def build_factors(self, odometry: SegmentedOdometry, config: GraphConfig) -> PositionFactors:
        """Return one factor for each fix; their times must be among those of the poses."""
        pose_index = np.searchsorted(odometry.pose_t, self.t)
        position = np.column_stack([self.position.real, self.position.imag])
        return PositionFactors(
            pose_index, position, self.sigma, odometry.velocity[pose_index], config.antenna
        )

    def select(self, flags: NDArray[np.bool_]) -> LocalFixes:
        """Return the fixes whose flag is set."""
        selected = (self.input_row[flags], self.t[flags], self.position[flags], self.sigma[flags])
        return LocalFixes(*selected, self.frame, self.warnings)


def localise_fix(fix: Fixes, frame: LocalFrame, config: GraphConfig, sigma_growth: float) -> LocalFixes:
    """Return a single new fix in an existing frame; sigma_growth: factor on its sigma."""
    declared = math.nan if fix.sigma is None else float(fix.sigma[0])
    sigma = (
        declared
        if config.use_declared_sigmas and math.isfinite(declared) and declared > 0.0
        else config.gnss_sigma
    )
    x, y = frame.to_local(fix.latitude_deg, fix.longitude_deg)
    position = np.nan_to_num(x, posinf=_OFF_GRID_DISTANCE, neginf=-_OFF_GRID_DISTANCE) + 1j * np.nan_to_num(
        y, posinf=_OFF_GRID_DISTANCE, neginf=-_OFF_GRID_DISTANCE
    )
    return LocalFixes(
        np.zeros(1, np.intp),
        fix.t,
        position,
        np.array([max(sigma, _MIN_POSITION_SIGMA) * sigma_growth]),
        frame,
    )


def localise_fixes(fixes: Fixes, start: float, end: float, sigma: float, use_declared: bool) -> LocalFixes:
    """Return the fixes between two times, in a frame whose origin is their median.

    sigma: m, for fixes that declare none, or for all of them when `use_declared` is false. Raises InputError
    with the reasons when none is usable.
    """
    if len(fixes.t) == 0:
        raise InputError("gnss: no fix in it; leave it out, or check the receiver")
    warnings: list[str] = []
    latitude, longitude = np.asarray(fixes.latitude_deg), np.asarray(fixes.longitude_deg)
    # NaN and infinity fail this test, too.
    on_earth = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 360.0)
    exchanged = ~on_earth & (np.abs(longitude) <= 90.0) & (np.abs(latitude) <= 180.0)
    _add_warning(
        warnings,
        fixes,
        ~on_earth,
        "are not on Earth (latitude beyond 90 or longitude beyond 360 degrees)"
        + ("; latitude and longitude look exchanged" if exchanged.any() else ""),
    )
    in_time = (fixes.t >= start) & (fixes.t <= end)
    _add_warning(
        warnings,
        fixes,
        on_earth & ((fixes.t < start - _MAX_TIME_OVERHANG) | (fixes.t > end + _MAX_TIME_OVERHANG)),
        f"lie outside the odometry ({start:.3f} to {end:.3f} s); if all do, the clocks differ",
    )
    keep = np.flatnonzero(on_earth & in_time)
    if len(keep) == 0:
        why = "; ".join(warnings) or "all lie outside the odometry's time"
        raise InputError(f"gnss: no usable fix: {why}; correct it or leave it out")
    first_longitude = longitude[keep[0]]
    longitude_offset = (longitude[keep] - first_longitude + 180.0) % 360.0 - 180.0
    frame = make_local_frame(
        float(np.median(latitude[keep])), float(first_longitude + np.median(longitude_offset))
    )
    x, y = frame.to_local(latitude[keep], longitude[keep])
    near = np.hypot(x, y) < MAX_DISTANCE_FROM_ORIGIN
    far = np.zeros(len(fixes.t), np.bool_)
    far[keep[~near]] = True
    _add_warning(
        warnings, fixes, far, f"lie more than {MAX_DISTANCE_FROM_ORIGIN / 1000.0:.0f} km from the others"
    )
    keep, x, y = keep[near], x[near], y[near]
    declared_sigma = (
        np.full(len(fixes.t), np.nan) if fixes.sigma is None or not use_declared else np.asarray(fixes.sigma)
    )
    declared_sigma = declared_sigma[keep]
    has_sigma = np.isfinite(declared_sigma) & (declared_sigma > 0.0)
    declared_sigma = np.maximum(np.where(has_sigma, declared_sigma, sigma), _MIN_POSITION_SIGMA)
    return LocalFixes(keep, np.asarray(fixes.t)[keep], x + 1j * y, declared_sigma, frame, tuple(warnings))


def _add_warning(warnings: list[str], fixes: Fixes, rejected: NDArray[np.bool_], reason: str) -> None:
    """Add a warning that counts the fixes with the flag `rejected`, if there are any."""
    rows = np.flatnonzero(rejected)
    if len(rows) > 0:
        warnings.append(
            f"gnss: {len(rows)} of {len(rejected)} fixes left out, the first in row {rows[0] + 1} "
            f"(t = {fixes.t[rows[0]]:.3f} s): they {reason}"
        )


def screen_fixes(path: Track, fixes: LocalFixes) -> tuple[LocalFixes, float, list[str]]:
    """Return the fixes that moved no further than the wheels rolled, with sigmas inflated to their scatter.

    The second value is the factor on the sigmas, the third holds the warnings.
    """
    distance_by_pose = np.append(0.0, np.cumsum(np.hypot(np.diff(path.x), np.diff(path.y))))
    distance = np.interp(fixes.t, path.t, distance_by_pose)
    new_warnings = []
    scatter = estimate_scatter(fixes.position, distance, fixes.sigma)
    if scatter > 1.0:
        fixes = replace(fixes, sigma=fixes.sigma * scatter)
        new_warnings.append(
            f"gnss: the fixes scatter {scatter:.1f} times as much as their sigma says; it was widened"
        )
    keep = find_consistent_fixes(fixes.position, distance, fixes.sigma)
    for first, last in find_bridged_runs(~keep):
        before = max(first - 1, 0) if first > 0 else last + 1
        jump = float(np.abs(fixes.position[first] - fixes.position[before]))
        new_warnings.append(
            f"gnss: {last - first + 1} fixes from t = {fixes.t[first]:.1f} to {fixes.t[last]:.1f} s "
            f"jumped, by {jump:.0f} m; left out"
        )
    return fixes.select(keep), scatter, new_warnings


def estimate_scatter(position: ComplexArray, distance: Array, sigma: Array) -> float:
    """Return the ratio of the scatter of the fixes to their sigma, from successive differences; at least 1.

    position: (M,) m; distance: (M,) m rolled until then; sigma: (M,) m. The median norm of the change of two
    white errors is 1.18 sqrt(2) sigma; the distance rolled in between is subtracted. A ratio below 1.3 is
    attributed to chance and returned as 1.
    """
    if len(position) < _MIN_FIXES_FOR_SCATTER:
        return 1.0
    excess_change = np.maximum(np.abs(np.diff(position)) - np.diff(distance), 0.0)
    scatter = float(np.median(excess_change / np.hypot(sigma[1:], sigma[:-1]))) / _RAYLEIGH_MEDIAN
    return scatter if scatter > _MIN_SCATTER else 1.0


def find_consistent_fixes(position: ComplexArray, distance: Array, sigma: Array) -> NDArray[np.bool_]:
    """Return a flag (M,) for the largest set of fixes that never moves further than the wheels rolled.

    A change beyond the distance rolled and six sigma of both fixes separates runs of fixes. Of the sequences
    of runs in which each can be reached from the one before, the one with the most fixes is kept.
    """
    n = len(position)
    noise = _JUMP_SIGMAS * np.hypot(sigma[1:], sigma[:-1])
    cuts = np.flatnonzero(np.abs(np.diff(position)) > _MAX_DISTANCE_RATIO * np.diff(distance) + noise) + 1
    if len(cuts) == 0 or len(cuts) > _MAX_RUNS:
        return np.ones(n, np.bool_)
    first, last = np.append(0, cuts), np.append(cuts, n) - 1
    run_length = last - first + 1
    best_count, previous_run = run_length.astype(np.float64), np.full(len(first), -1)
    for run in range(1, len(first)):
        reach = _MAX_DISTANCE_RATIO * (distance[first[run]] - distance[last[:run]])
        reach = reach + _JUMP_SIGMAS * np.hypot(sigma[first[run]], sigma[last[:run]])
        near = np.abs(position[first[run]] - position[last[:run]]) <= reach
        total = np.where(near, best_count[:run], 0.0)
        chosen = int(np.argmax(total))
        if total[chosen] > 0.0:
            best_count[run] += total[chosen]
            previous_run[run] = chosen
    keep = np.zeros(n, np.bool_)
    run = int(np.argmax(best_count))
    while run >= 0:
        keep[first[run] : last[run] + 1] = True
        run = int(previous_run[run])
    return keep
