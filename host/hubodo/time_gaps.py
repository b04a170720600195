"""Whether times are those of one record: a wild time stamp, or another day's, is far from all the others."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError

MAX_GAP = 300_000.0
"""s without a sample, three days and a half: a grid over more of them would not fit into memory."""


def check_time_gaps(t: Array, where: str, max_gap: float = MAX_GAP) -> None:
    """Raises InputError where nothing lies between two neighbours of t (N,), s, for longer than that."""
    if len(t) < 2 or t[-1] - t[0] <= max_gap:
        return
    row = int(np.argmax(np.diff(t)))
    if t[row + 1] - t[row] > max_gap:
        raise InputError(
            f"{where}: nothing between t = {t[row]:.6g} s and {t[row + 1]:.6g} s: a wild time stamp, or two "
            "records; leave one side of it out"
        )
