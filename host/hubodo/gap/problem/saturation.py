"""Saturation of sensors: limits of triads, and the weights of gyros that measure the speed together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.recording import Table

# Number of equal largest readings from which on they are taken for saturation.
_MIN_LIMIT_READINGS = 6
# Readings this close to a limit, relative to it, are at the limit.
_LIMIT_TOLERANCE = 1e-9


def find_saturation_limit(y: Array) -> float:
    """Return the limit at which a triad, (3, N), saturates; infinity if it does not.

    At a limit many of the largest magnitudes are equal.
    """
    values, counts = np.unique(np.abs(y), return_counts=True)
    # Without a limit, noise spreads the largest readings: fewer have the largest value than the values below
    # it.
    if len(values) > 4 and counts[-1] >= _MIN_LIMIT_READINGS and counts[-1] > 3 * counts[-4:-1].max():
        return float(values[-1])
    return np.inf


def is_at_limit(y: Array, limits: Array | float) -> NDArray[np.bool_]:
    """Return a mask of the readings at their limit, which may be infinite."""
    return np.asarray(np.abs(y) >= np.asarray(limits) * (1.0 - _LIMIT_TOLERANCE))


def is_spin_saturated(table: Table) -> NDArray[np.bool_]:
    """Return a mask, (N,), of the samples of a node whose rate about the axle is at the limit of the gyro."""
    limit = find_saturation_limit(np.stack([table[name] for name in ("gx", "gy", "gz")]))
    return is_at_limit(table["gz"], limit)


def weigh_speed_sources(t: Array, sources: Sequence[tuple[Array, NDArray[np.bool_]]]) -> Array:
    """Return the weights, (S, N), of S gyros in the speed at times t: equal, and zero while saturated.

    sources: for each gyro times, s, and whether its reading is saturated. Gyros that are all saturated at a
    time weigh equally.
    """
    is_valid = np.array([np.interp(t, times, saturated) == 0.0 for times, saturated in sources])
    is_valid |= ~is_valid.any(axis=0)
    return np.asarray(is_valid / is_valid.sum(axis=0))
