"""The surface speeds of another odometer, as means over the windows of the wheel filter."""

from __future__ import annotations

import numpy as np

from hubodo.fuse.wheel.window import WINDOW
from hubodo.recording import Table
from hubodo.time_gaps import check_time_gaps

_LONGEST = 0.5
"""s between rows; over what is longer an encoder says nothing. Estimated."""

SurfaceSpeeds = dict[int, tuple[float, float]]
"""m/s of the left and the right wheel, by the number of the window."""


def surface_speeds(table: Table) -> SurfaceSpeeds:
    """Of a table t, left, right; windows that it does not fill are left out. InputError for a wild time."""
    t = table.t
    if len(t) < 2:
        return {}
    check_time_gaps(t, "wheels")
    numbers = np.arange(int(np.ceil(t[0] / WINDOW)), int(np.floor(t[-1] / WINDOW)))
    if not len(numbers):
        return {}
    edges = np.append(numbers, numbers[-1] + 1) * WINDOW
    step = np.diff(t)
    hole = np.concatenate([[0.0], np.cumsum(np.where(step > _LONGEST, step, 0.0))])
    sound = np.diff(np.interp(edges, t, hole)) == 0.0
    means = []
    for side in ("left", "right"):
        # The integral of the straight lines between rows.
        way = np.concatenate([[0.0], np.cumsum(0.5 * (table[side][1:] + table[side][:-1]) * step)])
        place = np.clip(np.searchsorted(t, edges) - 1, 0, len(step) - 1)
        into = edges - t[place]
        slope = np.diff(table[side]) / step
        at = way[place] + into * (table[side][place] + 0.5 * into * slope[place])
        means.append(np.diff(at) / WINDOW)
    rows = zip(numbers[sound].tolist(), means[0][sound].tolist(), means[1][sound].tolist(), strict=True)
    return {number: (left, right) for number, left, right in rows}
