"""Alignment of a track with positions, and its residual errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.fuse.track import Track
from hubodo.fuse.wheel.calibration.positions import Positions

_MAX_MIRRORED_SHARE = 0.1
"""Ratio of squared errors below which the mirror image is taken as true: a third of the distance. Estimated.
"""

_MAX_CHORD_RATIO = 1.4
"""Ratio of distances beyond which no radius error explains them: a diameter in place of a radius makes 2."""

_CHORD_S = 5.0
"""s of a chord whose length is compared: long against the noise of positions, short against the drift."""

_ALIGNMENT_DISTANCE = 5.0
"""m of the drive used for alignment if positions are exact.

An uncalibrated filter drifts by less than a centimetre in it. Estimated.
"""


def align_heading(track: Track, target: Positions) -> float:
    """Return the start heading that aligns the track with the positions, rad.

    Only the first part of the drive is used, which is long compared with the position noise: later the track
    has drifted. Raise CalibrationError if the positions stay too near to the start.
    """
    distance = np.hypot(target.x - target.x[0], target.y - target.y[0])
    min_distance = max(_ALIGNMENT_DISTANCE, 10.0 * float(np.median(target.sigma)))
    if distance.max() < max(10.0, min_distance):
        raise CalibrationError(
            f"the positions reach {distance.max():.1f} m from the start; "
            f"drive {max(10.0, min_distance):.0f} m away"
        )
    count = int(np.argmax(distance > min_distance)) + 1
    track_points, position_points = _track_points(track, target.t[:count]), (target.x + 1j * target.y)[:count]
    return float(
        np.angle(np.sum((position_points - position_points[0]) * (track_points - track_points[0]).conj()))
    )


def check_axes(track: Track, target: Positions) -> None:
    """Raise CalibrationError if the track fits the mirror image of the positions far better."""
    declared, mirrored = (
        float(np.mean(position_errors(track, positions, (0.0, 0.0)) ** 2))
        for positions in (target, replace(target, y=-target.y))
    )
    if mirrored < _MAX_MIRRORED_SHARE * declared:
        raise CalibrationError(
            f"the track lies {math.sqrt(declared):.1f} m rms from the positions, {math.sqrt(mirrored):.1f} m "
            "from their mirror image: they are in mirrored axes (want x east, y north), or a side or facing "
            "is wrong"
        )


def check_distance(track: Track, target: Positions) -> None:
    """Raise CalibrationError if the positions cover far more or less distance than the track."""
    starts = np.arange(target.t[0], target.t[-1] - _CHORD_S, _CHORD_S)
    if len(starts) == 0:
        return
    edges = np.append(starts, starts[-1] + _CHORD_S)
    position_points = np.interp(edges, target.t, target.x) + 1j * np.interp(edges, target.t, target.y)
    rolled = float(np.sum(np.abs(np.diff(_track_points(track, edges)))))
    covered = float(np.sum(np.abs(np.diff(position_points))))
    if covered > 0.0 and not 1.0 / _MAX_CHORD_RATIO < rolled / covered < _MAX_CHORD_RATIO:
        raise CalibrationError(
            f"the wheels rolled {rolled / covered:.2f} times the distance between the positions: a diameter "
            "in place of wheel_radius, or positions in another unit; nothing is written"
        )


def rotated_track_at(track: Track, target: Positions, heading: float) -> Array:
    """Return the track at the times of the positions, rotated by a heading, (M,) complex x + iy in m."""
    return np.asarray(_track_points(track, target.t) * np.exp(1j * heading))


def position_errors(track: Track, target: Positions, antenna: tuple[float, float]) -> Array:
    """Return the distances between positions and the antenna of the best aligned track, (M,) m.

    Planar rigid alignment by least squares (Umeyama 1991, without scale).
    """
    arm = complex(*antenna) * np.exp(1j * np.interp(target.t, track.t, track.heading))
    track_points, position_points = _track_points(track, target.t) + arm, target.x + 1j * target.y
    track_points, position_points = (
        track_points - track_points.mean(),
        position_points - position_points.mean(),
    )
    turn = np.exp(1j * np.angle(np.sum(position_points * track_points.conj())))
    distances: Array = np.abs(position_points - track_points * turn)
    return distances


def _track_points(track: Track, t: Array) -> Array:
    return np.asarray(np.interp(t, track.t, track.x) + 1j * np.interp(t, track.t, track.y))
