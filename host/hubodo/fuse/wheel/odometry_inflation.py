"""Variance of each step of a wheel track beyond that of rolling wheels, for the factor graph."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.track import WheelTrack
from hubodo.fuse.wheel.window import WINDOW_S


def odometry_inflation(track: WheelTrack) -> Array:
    """Return the extra variance of each step of a track, (N - 1,) m² in any direction.

    While only accelerometers measure the speed, it is the growth of the position variance. A step that does
    not agree with its speed is a correction of earlier steps, so it may be wrong by its whole length.
    """
    dt = np.diff(track.t)
    course = 0.5 * (track.heading[:-1] + track.heading[1:])
    displacement = np.diff(track.x) + 1j * np.diff(track.y)
    correction = np.abs(displacement - track.speed[1:] * dt * np.exp(1j * course)) ** 2
    variance_growth = np.maximum(0.0, np.diff(track.covariance[:, 0, 0] + track.covariance[:, 1, 1]))
    # The speed at the end of an outage does not predict the distance during it.
    return np.where(dt < 1.5 * WINDOW_S, correction, 0.0) + np.where(
        track.inertial_speed[1:] > 0.0, variance_growth, 0.0
    )
