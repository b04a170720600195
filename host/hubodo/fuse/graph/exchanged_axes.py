"""Detection of fixes with exchanged latitude and longitude: they mirror the path of the wheels."""

from __future__ import annotations

import numpy as np

from hubodo.errors import InputError
from hubodo.fuse.graph.factors.between import ComplexArray
from hubodo.fuse.graph.fixes import Fixes
from hubodo.fuse.projection import make_local_frame
from hubodo.fuse.track import Track

_MIN_RATIO = 3.0
"""Ratio of both misfits from which the exchange is certain: drifting odometry alone makes them alike."""
_MIN_MISFIT = 0.05
"""Fraction of the fixes' extent: odometry whose heading drifts by 3 degrees has as much."""
_MIN_FIXES = 10
"""Fixes; fewer are aligned with any path."""


def check_exchanged_axes(path: Track, fixes: Fixes) -> None:
    """Raise InputError where the fixes agree with the wheels' path once latitude and longitude are exchanged.

    An exchange mirrors the drive at the diagonal and scales it by the cosines of both angles, so no rotation
    and shift of the path fits the fixes any more.
    """
    latitude, longitude = np.asarray(fixes.latitude_deg), np.asarray(fixes.longitude_deg)
    usable = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 90.0)
    usable &= (fixes.t >= path.t[0]) & (fixes.t <= path.t[-1])
    if np.count_nonzero(usable) < _MIN_FIXES:
        return
    t, latitude, longitude = fixes.t[usable], latitude[usable], longitude[usable]
    wheels = np.interp(t, path.t, path.x) + 1j * np.interp(t, path.t, path.y)
    as_given = _project(latitude, longitude)
    given, exchanged = (_misfit(wheels, fix) for fix in (as_given, _project(longitude, latitude)))
    if given > _MIN_RATIO * exchanged and given > _MIN_MISFIT * float(np.std(as_given)):
        raise InputError(
            f"gnss: latitude and longitude are exchanged: the fixes miss the wheels' path by {given:.1f} m, "
            f"and by {exchanged:.1f} m with {latitude[0]:.4f} as the longitude; exchange the columns"
        )


def _project(latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> ComplexArray:
    """Return east + i north of fixes, m, in a frame about the first one."""
    frame = make_local_frame(float(latitude_deg[0]), float(longitude_deg[0]))
    x, y = frame.to_local(latitude_deg, longitude_deg)
    return np.asarray(x + 1j * y)


def _misfit(wheels: ComplexArray, fixes: ComplexArray) -> float:
    """Return the median distance of fixes from the wheels' positions, rotated and shifted onto them, m."""
    wheels, fixes = wheels - np.mean(wheels), fixes - np.mean(fixes)
    rotation = np.exp(1j * np.angle(np.sum(np.conj(wheels) * fixes)))
    return float(np.median(np.abs(fixes - rotation * wheels)))
