"""Remove rows that no sensor can have measured: NaN, infinity and implausibly large values."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain

import numpy as np

from hubodo.recording import NODE_COLUMNS, TABLE_FILE_COLUMNS, Table, file_columns, missing_channels


def drop_non_finite_rows(tables: Mapping[str, Table]) -> tuple[dict[str, Table], list[str]]:
    """Return the tables without rows that hold NaN or infinity in a required column, and a note for each.

    A table without any finite row or without a required column is dropped. Optional columns (temperature,
    sigma) may be NaN, and so may channels that a node never measured if no node of the log measures all.
    """
    valid, notes = {}, []
    partial = _partial_nodes(tables)
    for name, table in tables.items():
        needed = file_columns(name)[0]
        if missing := [column for column in needed if column not in table]:
            notes.append(f"{name}: its columns {', '.join(missing)} are missing; left out")
            continue
        if name in partial:
            needed = _measured_columns(table)
        finite = np.isfinite(np.stack([table[column] for column in needed])).all(axis=0)
        n_bad = len(table) - int(np.count_nonzero(finite))
        if not n_bad:
            valid[name] = table
            continue
        first = float(table.t[np.argmin(finite)])
        notes.append(
            f"{name}: {n_bad} of {len(table)} rows hold NaN or infinity, first at t = {first:.3f} s; left out"
        )
        if n_bad < len(table):
            rows = {column: values[finite] for column, values in table.columns.items()}
            valid[name] = Table(rows, None if table.t_ns is None else table.t_ns[finite])
    return valid, notes


def _partial_nodes(tables: Mapping[str, Table]) -> set[str]:
    """Return the nodes that lack channels, if there is no complete one, as in a log of one gyro."""
    nodes = {
        name: table
        for name, table in tables.items()
        if name not in TABLE_FILE_COLUMNS and set(NODE_COLUMNS) <= set(table)
    }
    return set() if any(not missing_channels(table) for table in nodes.values()) else set(nodes)


def _measured_columns(table: Table) -> tuple[str, ...]:
    """Return time and the channels that a node measures: all, or those of a node with fewer axes.

    A node that measures no gyro axis has no valid row.
    """
    missing = missing_channels(table)
    measured = tuple(name for name in NODE_COLUMNS if name not in missing)
    return measured if set(measured) & set(NODE_COLUMNS[1:4]) else NODE_COLUMNS


_MAX_PLAUSIBLE_VALUE = 1e12
"""Largest plausible value in the unit of any column; squares of much larger ones overflow."""


def drop_implausible_rows(tables: Mapping[str, Table]) -> tuple[dict[str, Table], list[str]]:
    """Return the tables without rows of implausibly large values, and a note for each that had any."""
    valid, notes = {}, []
    for name, table in tables.items():
        known = [*chain(*file_columns(name))]
        implausible = np.zeros(len(table), bool)
        for column in known:
            if column in table and column != "t":
                implausible |= np.abs(table[column]) > _MAX_PLAUSIBLE_VALUE
        valid[name] = table
        if implausible.any():
            first, count = float(table.t[np.argmax(implausible)]), int(np.count_nonzero(implausible))
            notes.append(f"{name}: {count} rows hold numbers too large, first at t = {first:.3f} s; left out")
            rows = {column: values[~implausible] for column, values in table.columns.items()}
            valid[name] = Table(rows, None if table.t_ns is None else table.t_ns[~implausible])
    return valid, notes
