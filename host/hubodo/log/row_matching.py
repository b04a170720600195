"""Join rows of a table that was recorded in several channels by their sequence numbers."""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray


def match_sequences(sequences: list[NDArray[Any]]) -> tuple[NDArray[Any], int]:
    """Return the sequence numbers present in all channels, increasing, and the number of incomplete rows."""
    first = sequences[0]
    if bool((np.diff(first) > 0).all()) and all(np.array_equal(first, other) for other in sequences[1:]):
        return first, 0
    common = reduce(np.intersect1d, sequences)
    return common, max(len(np.union1d(common, sequence)) for sequence in sequences) - len(common)


def first_row_at_each_time(t: NDArray[np.float64]) -> NDArray[np.intp] | slice:
    """Return the index of the first row at each distinct time, in order of time."""
    if bool((np.diff(t) > 0).all()):
        return slice(None)
    return np.unique(t, return_index=True)[1]


def rows_of_sequences(sequence: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.intp] | slice:
    """Return the row of each wanted sequence number."""
    if np.array_equal(sequence, wanted):
        return slice(None)
    order = np.argsort(sequence, kind="stable")
    return order[np.searchsorted(sequence, wanted, sorter=order)]
