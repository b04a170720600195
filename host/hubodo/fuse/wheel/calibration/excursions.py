"""Excursions of positions: jumps that return, as RTK makes beside a house."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

_MAX_EXCURSION_S = 10.0
"""s after which a position that has not returned has jumped. On a real car they last 1 to 6 s. Estimated.
"""

_RETURN_SHARE = 0.5
"""Share of an excursion within which the positions must return to count as returned. Estimated."""


class Jump(NamedTuple):
    """A jump of the positions: index of the first one after it; change, x + iy in m."""

    position: int
    change: complex


def find_excursions(jumps: Sequence[Jump], t: Array) -> NDArray[Any]:
    """Return the mask, (M,), of the positions between a jump and the jump that returns from it.

    t: (M,) s. Several jumps may lead away and back.
    """
    excursion = np.zeros(len(t), bool)
    first = 0
    while first < len(jumps):
        offset, largest = 0j, 0.0
        start, after = jumps[first].position, first + 1
        for number in range(first, len(jumps)):
            index, change = jumps[number]
            if t[index] - t[start] > _MAX_EXCURSION_S:
                break
            offset += change
            largest = max(largest, abs(offset))
            if abs(offset) < _RETURN_SHARE * largest:
                excursion[start:index] = True
                after = number + 1
                break
        first = after
    return excursion
