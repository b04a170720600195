"""Samples of wheel nodes that no filter should see: a sensor that froze, a clock that went back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.fuse.wheel.preintegration import LONGEST_STEP
from hubodo.recording import Table

_FROZEN = 0.5
"""s without a change of one bit: noise alone changes some bit of six within a few samples."""

_OTHER_TURNS = 0.1
"""rad/s of spread in the rates of the other wheel, by which a vehicle is known to move.

A thousand times the noise of the LSM6DS33 in a sample.
"""

_RUN, _CROWDED = 20, 0.6
"""So many samples in less than this share of their usual time are of two times.

Those of one clock would take half of it when mixed one to one. Estimated.
"""


def screened(nodes: Mapping[str, Table]) -> tuple[dict[str, Table], tuple[str, ...]]:
    """The tables of all wheel nodes without such samples, and one line for each stretch left out."""
    kept, said = {}, []
    for name, table in nodes.items():
        others = [other for other_name, other in nodes.items() if other_name != name]
        mixed, frozen = _mixed(table.t), _frozen(table, others)
        for bad, why in (
            (mixed, "samples of two times stand between one another: its clock went back"),
            (frozen & ~mixed, "not one bit of its samples changed while the other wheel turned: it froze"),
        ):
            for first, last in stretches(bad):
                span = f"from t = {table.t[first]:.1f} to {table.t[last]:.1f} s"
                said.append(f"{name}: {span} {why}; left out, sigmas grow there")
        good = ~(mixed | frozen)
        kept[name] = table if good.all() else Table({key: v[good] for key, v in table.columns.items()})
    return kept, tuple(said)


def own_gaps(tables: Sequence[Table]) -> list[list[float]]:
    """Times, s, at which gaps begin that no other table has at that time, for each table."""
    starts = [table.t[:-1][np.diff(table.t) > LONGEST_STEP] for table in tables]
    found = []
    for own in starts:
        others = np.concatenate([np.empty(0), *(other for other in starts if other is not own)])
        near = np.abs(own[:, None] - others[None, :]) < LONGEST_STEP
        found.append(own[~near.any(axis=1)].tolist())
    return found


def _frozen(table: Table, others: list[Table]) -> NDArray[np.bool_]:
    """(N,) samples that repeat the one before for `_FROZEN` s and more while another node's rates vary.

    At rest the samples of a simulation without noise are alike as well; there the other wheel rests, too.
    """
    found = np.zeros(len(table), np.bool_)
    rows = np.hstack([table.gyro, table.accel])
    alike = np.append(False, (rows[1:] == rows[:-1]).all(axis=1))
    for first, last in stretches(alike):
        begin, end = table.t[first], table.t[last]
        if end - begin < _FROZEN:
            continue
        for other in others:
            inside = (other.t >= begin) & (other.t <= end)
            if np.count_nonzero(inside) > 2 and other.gyro[inside].std(axis=0).max() > _OTHER_TURNS:
                found[first : last + 1] = True
    return found


def _mixed(t: Array) -> NDArray[np.bool_]:
    """(N,) samples that stand much closer together than most do, for `_RUN` of them and more.

    After a clock went back, a log in order of time has those of before and after between one another.
    """
    found = np.zeros(len(t), np.bool_)
    if len(t) < 4 * _RUN:
        return found
    crowded = t[_RUN:] - t[:-_RUN] < _CROWDED * _RUN * float(np.median(np.diff(t)))
    for first in np.flatnonzero(crowded).tolist():
        found[first : first + _RUN + 1] = True
    return found


def stretches(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last number of each stretch of flags that are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(first, end - 1) for first, end in list(pairwise(edges.tolist()))[::2]]
