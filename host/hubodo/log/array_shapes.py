"""Which arrays of a file count as tables of numbers, and which way their rows run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_COLUMNS = 32
_MOST_NUMBERS = 1 << 60  # of float64, more than any computer addresses


def is_table(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bool:
    """Return True for more than one integer or float in one or two dimensions."""
    return (
        dtype.kind in "iuf"
        and len(shape) in (1, 2)
        and min(shape) >= 0
        and 1 < math.prod(shape) < _MOST_NUMBERS
    )


def as_rows(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, C): a row for each sample, as MATLAB writes columns and HDF5 gives them back as rows."""
    if values.ndim == 1:
        return values[:, None]
    return values.T.copy() if _is_lying(values.shape) else values


def shape_only(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return zeros of the shape that `as_rows` gives, without memory for them."""
    rows = (*shape, 1) if len(shape) == 1 else shape[::-1] if _is_lying(shape) else shape
    return np.broadcast_to(np.zeros(()), rows)


def _is_lying(shape: tuple[int, ...]) -> bool:
    return shape[0] < shape[1] and shape[0] <= _MOST_COLUMNS
