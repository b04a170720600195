"""Rows of a file that lie in several channels, met again by their sequence numbers."""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray


def shared_rows(sequences: list[NDArray[Any]]) -> tuple[NDArray[Any], int]:
    """Row numbers that every part of a file has, rising, and how many rows have lost a part."""
    first = sequences[0]
    if bool((np.diff(first) > 0).all()) and all(np.array_equal(first, other) for other in sequences[1:]):
        return first, 0
    common = reduce(np.intersect1d, sequences)
    return common, max(len(np.union1d(common, sequence)) for sequence in sequences) - len(common)


def rising_rows(t: NDArray[np.float64]) -> NDArray[np.intp] | slice:
    """Places of the first row at each time, in order of time."""
    if bool((np.diff(t) > 0).all()):
        return slice(None)
    return np.unique(t, return_index=True)[1]


def places_of(sequence: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.intp] | slice:
    """Where each wanted sequence number stands."""
    if np.array_equal(sequence, wanted):
        return slice(None)
    order = np.argsort(sequence, kind="stable")
    return order[np.searchsorted(sequence, wanted, sorter=order)]
