"""Detection of frozen readings: a sensor repeats one value for longer than its noise allows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError

_MAX_EQUAL_SHARE, _MAX_REPEAT_PROBABILITY = 0.45, 0.7
"""Share of neighbours with equal values, up to which long runs are tested, and the probability that a sample
equals the one before. With steps of 1.8 sigma normal noise has a share of 0.45, averaged over the phase, and
repeats a value in the middle of a code with 0.63; a coarser channel stays on one value without any fault.
"""
_FALSE_ALARM_PROBABILITY = 1e-6
"""Probability that a record of independent samples has a run of the length that is reported."""
_MIN_RUN_RATIO = 10.0
"""Length over that of nine in ten runs of the record: a slow sensor that is read often repeats each value."""


def find_frozen_spans(t: Array, values: Array) -> list[tuple[float, float]]:
    """Return the time spans (start, end in s) in which a channel repeats one value without noise.

    A run of n equal samples in a record of N has at most the probability N p^n, where p, the probability that
    a sample equals the one before, is taken at its bound of 0.7.

    Parameters
    ----------
    t : (N,) s.
    values : (N,) readings of one channel.
    """
    if len(values) < 2:
        return []
    edges = np.flatnonzero(np.concatenate(([True], np.diff(values) != 0.0, [True])))
    lengths: NDArray[np.int64] = np.diff(edges)
    typical = float(np.quantile(lengths, 0.9))
    chance = np.log(_FALSE_ALARM_PROBABILITY / len(values)) / np.log(_MAX_REPEAT_PROBABILITY)
    frozen = lengths > max(chance, _MIN_RUN_RATIO * typical)
    others = lengths[~frozen]
    if not len(others) or 1.0 - len(others) / others.sum() > _MAX_EQUAL_SHARE:
        return []
    starts, ends = edges[:-1][frozen], np.minimum(edges[1:][frozen], len(t) - 1)
    return [(float(t[start]), float(t[end])) for start, end in zip(starts, ends, strict=True)]


def check_not_frozen(t: Array, values: Array, channel: str) -> None:
    """Raise InputError with the first time at which a channel repeats one value, if it does."""
    spans = find_frozen_spans(t, values)
    if not spans:
        return
    start, end = spans[0]
    more = f" and in {len(spans) - 1} more stretches" if len(spans) > 1 else ""
    raise InputError(
        f"{channel} repeats one value from {start:.6g} to {end:.6g} s{more}: the sensor or its link was "
        f"frozen; select another part by --start and --end (here --end {start:.6g} or --start {end:.6g})"
    )
