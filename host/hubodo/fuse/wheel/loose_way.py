"""How far the way between two poses may be off beyond what wheels that roll leave open: for a graph."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.track import WheelTrack
from hubodo.fuse.wheel.window import WINDOW


def loose_way(track: WheelTrack) -> Array:
    """(N - 1,) m², variance of each step of a track in any direction.

    Where only accelerometers tell the speed it is what the place becomes less sure by. And a step that leads
    elsewhere than its speed does takes back what was wrong before: it may be as wrong as it is long.
    """
    dt = np.diff(track.t)
    course = 0.5 * (track.heading[:-1] + track.heading[1:])
    went = np.diff(track.x) + 1j * np.diff(track.y)
    taken_back = np.abs(went - track.speed[1:] * dt * np.exp(1j * course)) ** 2
    grown = np.maximum(0.0, np.diff(track.covariance[:, 0, 0] + track.covariance[:, 1, 1]))
    # Over a silence the way is not that at the speed of its end.
    return np.where(dt < 1.5 * WINDOW, taken_back, 0.0) + np.where(track.carrying[1:] > 0.0, grown, 0.0)
