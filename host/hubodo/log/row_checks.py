"""Rows that nothing can have measured, NaN and infinity first: left out and told, so that a gap is left."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain

import numpy as np

from hubodo.recording import NODE_COLUMNS, NODE_OPTIONAL_COLUMNS, TABLE_FILE_COLUMNS, Table


def drop_non_finite_rows(tables: Mapping[str, Table]) -> tuple[dict[str, Table], list[str]]:
    """The tables without such rows, by name, and a line for each that had any.

    A table of nothing else is dropped, and one that lost a column that it must have. Of the rest only what a
    table must have counts: a temperature or a sigma that is not known stays as it is.
    """
    valid, notes = {}, []
    for name, table in tables.items():
        needed = TABLE_FILE_COLUMNS.get(name, (NODE_COLUMNS,))[0]
        if missing := [column for column in needed if column not in table]:
            notes.append(f"{name}: its columns {', '.join(missing)} are lost; left out")
            continue
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


_MAX_PLAUSIBLE_VALUE = 1e12
"""In any unit of a table: no sensor and no place reads more, and the square of what does may be infinite."""


def drop_implausible_rows(tables: Mapping[str, Table]) -> tuple[dict[str, Table], list[str]]:
    """The tables without rows of numbers that are too large to be any, and a line for each that had some."""
    valid, notes = {}, []
    for name, table in tables.items():
        known = [*chain(*TABLE_FILE_COLUMNS.get(name, ((*NODE_COLUMNS, *NODE_OPTIONAL_COLUMNS), ())))]
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
