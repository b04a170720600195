"""Code density test of a stationary channel (IEEE 1241): missing codes and uneven steps of its converter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

_MIN_EXPECTED_COUNT = 40.0
"""A code expected this often is missing by chance once in 10^17 records."""
_MAX_CODES = 4000
_MIN_COUNT, _MIN_SHAPE_CODES, _MAX_SHAPE_CODES = 400, 5, 60
"""Occurrences of the codes whose widths are compared, and their number."""


def count_codes(values: Array, step: float) -> NDArray[np.int64]:
    """Return the occurrences of each code of a channel (N,), (M,) from the lowest code on.

    step: of the converter, in the unit of the channel. There are none without a step or for too many codes.
    """
    span = float(np.ptp(values))
    if step <= 0.0 or np.rint(span / step) >= _MAX_CODES:
        return np.zeros(0, np.int64)
    return np.bincount(np.rint((values - values.min()) / step).astype(np.int64))


def missing_codes(counts: NDArray[np.int64]) -> tuple[int, int]:
    """Return how many codes are missing, and how many are expected, from the occurrences of each, (M,).

    A code is expected if both neighbouring levels that do occur have counts far above chance: the noise of a
    stationary sensor passes each code between them. Codes that are as wide as many sigma are not judged.
    """
    occurring = np.flatnonzero(counts)
    gaps = np.diff(occurring) - 1
    lower = np.minimum(counts[occurring[:-1]], counts[occurring[1:]])
    # A missing code adds its share to a neighbour, so half of the smaller neighbour is expected in it.
    judged = lower > 2.0 * _MIN_EXPECTED_COUNT
    missing = int(gaps[judged & (gaps > 0)].sum())
    return missing, missing + int(np.count_nonzero(counts > _MIN_EXPECTED_COUNT))


def uneven_steps(counts: NDArray[np.int64]) -> float:
    """Return the relative differential nonlinearity (rms) from the occurrences, (M,); 0 if not shown.

    The noise of a stationary sensor is a smooth density, whose logarithm is a parabola over the codes; what
    the counts deviate from it, beyond their own scatter, are differences of the widths of the codes.
    """
    used = np.flatnonzero(counts > _MIN_COUNT)
    if not _MIN_SHAPE_CODES <= len(used) <= _MAX_SHAPE_CODES:
        return 0.0
    weights = np.sqrt(np.minimum(counts[used], counts[used].max() / 10.0))
    parabola = np.polynomial.Polynomial.fit(used, np.log(counts[used]), 2, w=weights)
    residual = np.log(counts[used]) - parabola(used)
    dof = len(used) - 3
    variance = float(np.sum(residual**2)) / dof - float(np.mean(1.0 / counts[used]))
    return float(np.sqrt(max(variance, 0.0)))
