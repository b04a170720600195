"""Is the demo's track as good as it says itself?"""

from __future__ import annotations

import numpy as np

from hubodo.errors import HubodoError
from hubodo.fuse.track import Track
from hubodo.recording import Table

_SIGMAS = 5.0
"""Of the length of the error; of honest ones, one in 200,000 is longer."""

_FLOOR = 0.02
"""m by which a track may be off where it has hardly begun: its sigma is that of its first centimetres."""


def check_sigmas(track: Track, truth: Table, log: str) -> None:
    """Raises HubodoError where the track is farther from the truth (t, x, y) than its own sigmas allow.

    Both begin at the same point.
    """
    common = (track.t >= truth.t[0]) & (track.t <= truth.t[-1])
    x = track.x[common] - np.interp(track.t[common], truth.t, truth["x"])
    y = track.y[common] - np.interp(track.t[common], truth.t, truth["y"])
    if not len(x):
        return
    off = np.hypot(x - x[0], y - y[0])
    allowed = _SIGMAS * np.hypot(track.sigma_x, track.sigma_y)[common] + _FLOOR
    worst = int(np.argmax(off - allowed))
    if off[worst] > allowed[worst]:
        raise HubodoError(
            f"the track is {off[worst]:.2f} m from the truth at t = {track.t[common][worst]:.1f} s and says "
            f"that it is right to {allowed[worst] / _SIGMAS:.3f} m, 1 sigma; see hubodo info {log}"
        )
