"""Garbage collection of computations that keep millions of objects."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_NEW_OBJECTS = 100_000
"""New container objects between two searches for cyclic garbage, instead of 700."""


@contextmanager
def rare_garbage_collection() -> Iterator[None]:
    """Search for cyclic garbage rarely; usable as a decorator.

    The steps of an hour are a million tuples and arrays that all stay in use, and that each search visits:
    a tenth of the processor time of a filter run. Objects without cycles are freed at once as always.
    """
    thresholds = gc.get_threshold()
    if thresholds[0]:  # 0: the calling program has disabled the search
        gc.set_threshold(max(thresholds[0], _NEW_OBJECTS), *thresholds[1:])
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)
