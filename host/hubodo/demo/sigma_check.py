"""Check of the demo's track against its own sigmas."""

from __future__ import annotations

import numpy as np

from hubodo.errors import HubodoError
from hubodo.fuse.track import Track
from hubodo.recording import Table

MAX_ERROR_SIGMA = 5.0
"""Largest plausible position error; 1 in 270,000 errors of a 2-D Gaussian is larger."""

MIN_ALLOWED_ERROR_M = 0.02
"""Allowance in m near the start, where sigma covers only the first centimetres."""


def check_sigmas(track: Track, truth: Table, log: str) -> None:
    """Raise HubodoError where the track is farther from the truth (t, x, y) than its sigmas allow.

    Both paths start at the same point.
    """
    common = (track.t >= truth.t[0]) & (track.t <= truth.t[-1])
    x = track.x[common] - np.interp(track.t[common], truth.t, truth["x"])
    y = track.y[common] - np.interp(track.t[common], truth.t, truth["y"])
    if not len(x):
        return
    error = np.hypot(x - x[0], y - y[0])
    allowed = MAX_ERROR_SIGMA * np.hypot(track.sigma_x, track.sigma_y)[common] + MIN_ALLOWED_ERROR_M
    worst = int(np.argmax(error - allowed))
    if error[worst] > allowed[worst]:
        raise HubodoError(
            f"the track is {error[worst]:.2f} m from the truth at t = {track.t[common][worst]:.1f} s, but "
            f"its 1 sigma is {allowed[worst] / MAX_ERROR_SIGMA:.3f} m; see hubodo info {log}"
        )
