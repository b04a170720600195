"""Check that the time stamps of a log's nodes are in seconds and overlap."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from hubodo.errors import InputError
from hubodo.fuse.wheel.preintegration import MAX_SAMPLE_STEP
from hubodo.recording import Table

_MIN_SAMPLE_STEP_S = 1.0 / 7000.0
"""s between samples at 7 kHz; the fastest rate of an LSM6DS33 is 6.66 kHz."""

_UNITS_PER_SECOND = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


def check_times(nodes: Mapping[str, Table], log: str) -> None:
    """Raise InputError if samples are too slow, in another unit, or if nodes have no common time."""
    for name, table in nodes.items():
        if len(table) < 3:
            continue
        step = float(np.median(np.diff(table.t)))
        if step <= MAX_SAMPLE_STEP:
            continue
        description = (
            f"{log}: {name}: samples are {step:g} s apart, from t = {table.t[0]:g} to {table.t[-1]:g} s"
        )
        for unit, per_second in _UNITS_PER_SECOND.items():
            if _MIN_SAMPLE_STEP_S <= step / per_second <= MAX_SAMPLE_STEP:
                raise InputError(f"{description}; they look like {unit}: divide t by {per_second:.0f}")
        raise InputError(f"{description}; a wheel needs {1.0 / MAX_SAMPLE_STEP:g} samples a second or more")
    names = [name for name, table in nodes.items() if len(table)]
    for first_name, second_name in combinations(names, 2):
        a, b = nodes[first_name].t, nodes[second_name].t
        if a[0] > b[-1] or b[0] > a[-1]:
            raise InputError(
                f"{log}: {first_name} lasts from t = {a[0]:.1f} to {a[-1]:.1f} s, {second_name} from "
                f"{b[0]:.1f} to {b[-1]:.1f} s: no time in common; put both on one clock, or fuse one alone "
                "with --nodes"
            )
