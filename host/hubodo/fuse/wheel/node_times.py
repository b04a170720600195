"""Check that the time stamps of a log's nodes are in seconds and overlap."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from hubodo.errors import InputError
from hubodo.fuse.wheel.preintegration import LONGEST_STEP
from hubodo.recording import Table

_SHORTEST_STEP = 1.0 / 7000.0
"""s between samples at 7 kHz; the fastest rate of an LSM6DS33 is 6.66 kHz."""

_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


def check_times(nodes: Mapping[str, Table], log: str) -> None:
    """Raise InputError if samples are too slow, in another unit, or if nodes have no common time."""
    for name, table in nodes.items():
        if len(table) < 3:
            continue
        step = float(np.median(np.diff(table.t)))
        if step <= LONGEST_STEP:
            continue
        seen = f"{log}: {name}: samples are {step:g} s apart, from t = {table.t[0]:g} to {table.t[-1]:g} s"
        for unit, per_second in _UNITS.items():
            if _SHORTEST_STEP <= step / per_second <= LONGEST_STEP:
                raise InputError(f"{seen}; they look like {unit}: divide t by {per_second:.0f}")
        raise InputError(f"{seen}; a wheel needs {1.0 / LONGEST_STEP:g} samples a second or more")
    names = [name for name, table in nodes.items() if len(table)]
    for one, other in combinations(names, 2):
        a, b = nodes[one].t, nodes[other].t
        if a[0] > b[-1] or b[0] > a[-1]:
            raise InputError(
                f"{log}: {one} lasts from t = {a[0]:.1f} to {a[-1]:.1f} s, {other} from {b[0]:.1f} to "
                f"{b[-1]:.1f} s: no time in common; put both on one clock, or fuse one alone with --nodes"
            )
