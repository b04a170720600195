"""Whether times are those of one record: a wild time stamp, or another day's, is far from all the others."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError

_LONGEST = 300_000.0
"""s without a sample, three days and a half: a grid over more of them would not fit into memory."""


def check_one_record(t: Array, where: str, longest: float = _LONGEST) -> None:
    """Raises InputError where nothing lies between two neighbours of t (N,), s, for longer than that."""
    if len(t) < 2 or t[-1] - t[0] <= longest:
        return
    row = int(np.argmax(np.diff(t)))
    if t[row + 1] - t[row] > longest:
        raise InputError(
            f"{where}: nothing between t = {t[row]:.6g} s and {t[row + 1]:.6g} s: a wild time stamp, or two "
            "records; leave one side of it out"
        )
