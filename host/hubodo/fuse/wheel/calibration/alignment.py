"""A track laid on the positions, and how far it then is from them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.calibration.positions import Positions
from hubodo.fuse.wheel.track import WheelTrack

_MIRRORED = 0.1
"""Share of the squares below which the mirror image is what was driven: a third of the way. Estimated."""

_ALIGN_DISTANCE = 5.0
"""m of the drive by which the track is laid on the positions, where these are exact.

So far a filter that knows nothing drifts by less than a centimetre. Estimated.
"""


def align_heading(track: WheelTrack, told: Positions) -> float:
    """Heading at the start under which the track lies on the positions, rad.

    The angle is taken over the first part that is long against the positions' noise: later the track has
    drifted. Raises CalibrationError: the positions stay too near to the start.
    """
    way = np.hypot(told.x - told.x[0], told.y - told.y[0])
    reach = max(_ALIGN_DISTANCE, 10.0 * float(np.median(told.sigma)))
    if way.max() < max(10.0, reach):
        raise CalibrationError(
            f"the positions reach {way.max():.1f} m from the start; drive {max(10.0, reach):.0f} m away"
        )
    upto = int(np.argmax(way > reach)) + 1
    ours, theirs = _places(track, told.t[:upto]), (told.x + 1j * told.y)[:upto]
    return float(np.angle(np.sum((theirs - theirs[0]) * (ours - ours[0]).conj())))


def check_axes(track: WheelTrack, told: Positions) -> None:
    """Raises CalibrationError where the track lies far better on the mirror image of the positions."""
    as_told, mirrored = (
        float(np.mean(position_errors(track, positions, (0.0, 0.0)) ** 2))
        for positions in (told, replace(told, y=-told.y))
    )
    if mirrored < _MIRRORED * as_told:
        raise CalibrationError(
            f"the track lies {math.sqrt(as_told):.1f} m rms from the positions, {math.sqrt(mirrored):.1f} m "
            "from their mirror image: they are in mirrored axes (want x east, y north), or a side or facing "
            "is wrong"
        )


def rotated_track_at(track: WheelTrack, told: Positions, heading: float) -> Array:
    """(M,) complex, x + iy in m: the track at the times of the positions, turned by a heading, rad."""
    return np.asarray(_places(track, told.t) * np.exp(1j * heading))


def position_errors(track: WheelTrack, told: Positions, antenna: tuple[float, float]) -> Array:
    """(M,) m between positions and the antenna of a track that is laid on them as well as it can be.

    A plane rigid alignment in the sense of least squares (Umeyama 1991, without scale).
    """
    arm = complex(*antenna) * np.exp(1j * np.interp(told.t, track.t, track.heading))
    ours, theirs = _places(track, told.t) + arm, told.x + 1j * told.y
    ours, theirs = ours - ours.mean(), theirs - theirs.mean()
    turn = np.exp(1j * np.angle(np.sum(theirs * ours.conj())))
    distances: Array = np.abs(theirs - ours * turn)
    return distances


def _places(track: WheelTrack, t: Array) -> Array:
    return np.asarray(np.interp(t, track.t, track.x) + 1j * np.interp(t, track.t, track.y))
