"""Detection of gaps in time so large that the stamps cannot belong to one recording."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError

MAX_GAP = 300_000.0
"""s, three and a half days; a time grid over a longer gap would not fit into memory."""


def check_time_gaps(t: Array, where: str, max_gap: float = MAX_GAP) -> None:
    """Raise InputError if two successive times of t (N,), s, are more than max_gap, s, apart."""
    if len(t) < 2 or t[-1] - t[0] <= max_gap:
        return
    row = int(np.argmax(np.diff(t)))
    if t[row + 1] - t[row] > max_gap:
        raise InputError(
            f"{where}: nothing between t = {t[row]:.6g} s and {t[row + 1]:.6g} s: a wild time stamp, or two "
            "records; remove one side of it"
        )
