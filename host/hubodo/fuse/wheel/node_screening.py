"""Reject samples of wheel nodes before filtering: frozen sensors and clocks that went back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.wheel.preintegration import LONGEST_STEP
from hubodo.recording import Table

_FROZEN = 0.5
"""s without a change of any bit; sensor noise changes a bit of six axes within a few samples."""

_OTHER_TURNS = 0.1
"""rad/s, standard deviation of the other wheel's rates above which the vehicle moves.

A thousand times the noise of an LSM6DS33 sample.
"""

_RUN, _CROWDED = 20, 0.6
"""Number of samples, and the share of their usual duration below which they come from two interleaved
records.

Two records mixed one to one take half of the usual duration. Estimated.
"""


def screen_samples(nodes: Mapping[str, Table]) -> tuple[dict[str, Table], tuple[str, ...]]:
    """Return the tables of all wheel nodes without rejected samples, and one line for each rejected run."""
    kept, said = {}, []
    for name, table in nodes.items():
        others = [other for other_name, other in nodes.items() if other_name != name]
        mixed, frozen = _mixed(table.t), _frozen(table, others)
        for bad, why in (
            (mixed, "samples of two times stand between one another: its clock went back"),
            (frozen & ~mixed, "not one bit of its samples changed while the other wheel turned: it froze"),
        ):
            for first, last in find_runs(bad):
                span = f"from t = {table.t[first]:.1f} to {table.t[last]:.1f} s"
                said.append(f"{name}: {span} {why}; left out, sigmas grow there")
        good = ~(mixed | frozen)
        kept[name] = table if good.all() else Table({key: v[good] for key, v in table.columns.items()})
    return kept, tuple(said)


def find_own_gaps(tables: Sequence[Table]) -> list[list[float]]:
    """Return, for each table, the start times (s) of gaps that no other table has at the same time."""
    starts = [table.t[:-1][np.diff(table.t) > LONGEST_STEP] for table in tables]
    found = []
    for own in starts:
        others = np.concatenate([np.empty(0), *(other for other in starts if other is not own)])
        near = np.abs(own[:, None] - others[None, :]) < LONGEST_STEP
        found.append(own[~near.any(axis=1)].tolist())
    return found


def _frozen(table: Table, others: list[Table]) -> NDArray[np.bool_]:
    """Return a mask (N,) of samples repeated for `_FROZEN` s or longer while another node rotates.

    A noise-free simulation at standstill repeats samples too; there the other wheel stands still as well.
    """
    found = np.zeros(len(table), np.bool_)
    rows = np.hstack([table.gyro, table.accel])
    alike = np.append(False, (rows[1:] == rows[:-1]).all(axis=1))
    for first, last in find_runs(alike):
        begin, end = table.t[first], table.t[last]
        if end - begin < _FROZEN:
            continue
        for other in others:
            inside = (other.t >= begin) & (other.t <= end)
            if np.count_nonzero(inside) > 2 and other.gyro[inside].std(axis=0).max() > _OTHER_TURNS:
                found[first : last + 1] = True
    return found


def _mixed(t: Array) -> NDArray[np.bool_]:
    """Return a mask (N,) of runs of `_RUN` or more samples that follow each other much faster than most do.

    After a clock went back, a log sorted by time interleaves the samples from before and after.
    """
    found = np.zeros(len(t), np.bool_)
    if len(t) < 4 * _RUN:
        return found
    crowded = t[_RUN:] - t[:-_RUN] < _CROWDED * _RUN * float(np.median(np.diff(t)))
    for first in np.flatnonzero(crowded).tolist():
        found[first : first + _RUN + 1] = True
    return found


def find_runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of each run of True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(first, end - 1) for first, end in list(pairwise(edges.tolist()))[::2]]
