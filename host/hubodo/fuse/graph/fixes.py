"""GNSS fixes as they stand in a log, to what the graph can use; what it cannot is said."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.between import Complex
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.steps import CutPath
from hubodo.fuse.projection import FARTHEST, LocalFrame, local_frame

_FINEST = 0.005
"""m; the centre of an antenna is no better known, whatever a receiver says."""
_AWAY = 1e7
"""m; a fix beyond the grid is a quarter of the way round the Earth, for a loss to refuse."""
_EDGE = 2.0
"""s; a receiver that runs a little longer than the wheels is nothing to speak of."""


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

    row: NDArray[np.intp]
    t: Array
    place: Complex
    sigma: Array
    frame: LocalFrame
    warnings: tuple[str, ...] = ()

    @property
    def marks(self) -> Array:
        """A pose stands at each fix."""
        return self.t

    def factors(self, cut: CutPath, config: GraphConfig) -> PositionFactors:
        """One for each fix; the times must be among those of the poses."""
        state = np.searchsorted(cut.state_t, self.t)
        place = np.column_stack([self.place.real, self.place.imag])
        return PositionFactors(state, place, self.sigma, cut.velocity[state], config.antenna)

    def chosen(self, keep: NDArray[np.bool_]) -> LocalFixes:
        """Those with a flag that is set."""
        own = (self.row[keep], self.t[keep], self.place[keep], self.sigma[keep])
        return LocalFixes(*own, self.frame, self.warnings)


def one_fix(fix: Fixes, frame: LocalFrame, config: GraphConfig, growth: float) -> LocalFixes:
    """A fix as it comes, in a frame that stands. growth: times which its sigma is widened."""
    own = math.nan if fix.sigma is None else float(fix.sigma[0])
    sigma = own if config.declared and math.isfinite(own) and own > 0.0 else config.gnss_sigma
    x, y = frame.to_local(fix.latitude_deg, fix.longitude_deg)
    place = np.nan_to_num(x, posinf=_AWAY, neginf=-_AWAY) + 1j * np.nan_to_num(y, posinf=_AWAY, neginf=-_AWAY)
    return LocalFixes(np.zeros(1, np.intp), fix.t, place, np.array([max(sigma, _FINEST) * growth]), frame)


def usable_fixes(fixes: Fixes, begin: float, end: float, sigma: float, declared: bool) -> LocalFixes:
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
    near = np.hypot(x, y) < FARTHEST
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
