"""Decide which arrays of a file are tables of numbers, and along which axis their samples run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MAX_TABLE_COLUMNS = 32
_MAX_NUMBERS = 1 << 60  # float64 numbers, more than any computer can address


def is_number_table(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bool:
    """Return True for more than one integer or float in one or two dimensions."""
    return (
        dtype.kind in "iuf"
        and len(shape) in (1, 2)
        and min(shape) >= 0
        and 1 < math.prod(shape) < _MAX_NUMBERS
    )


def samples_as_rows(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the table as (N, C), one sample per row; MATLAB columns appear as rows in HDF5."""
    if values.ndim == 1:
        return values[:, None]
    return values.T.copy() if _has_samples_in_columns(values.shape) else values


def placeholder_rows(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return zeros of the shape that `samples_as_rows` returns, without allocating them."""
    rows = (*shape, 1) if len(shape) == 1 else shape[::-1] if _has_samples_in_columns(shape) else shape
    return np.broadcast_to(np.zeros(()), rows)


def _has_samples_in_columns(shape: tuple[int, ...]) -> bool:
    return shape[0] < shape[1] and shape[0] <= _MAX_TABLE_COLUMNS
