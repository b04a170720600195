"""Rows that nothing can have measured, NaN and infinity first: left out and told, so that a gap is left."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain

import numpy as np

from hubodo.recording import NODE_COLUMNS, NODE_OPTIONAL_COLUMNS, TABLE_FILE_COLUMNS, Table


def sound_tables(tables: Mapping[str, Table]) -> tuple[dict[str, Table], list[str]]:
    """The tables without such rows, by name, and a line for each that had any.

    A table of nothing else is dropped, and one that lost a column that it must have. Of the rest only what a
    table must have counts: a temperature or a sigma that is not known stays as it is.
    """
    kept, said = {}, []
    for name, table in tables.items():
        needed = TABLE_FILE_COLUMNS.get(name, (NODE_COLUMNS,))[0]
        if lacking := [column for column in needed if column not in table]:
            said.append(f"{name}: its columns {', '.join(lacking)} are lost; left out")
            continue
        good = np.isfinite(np.stack([table[column] for column in needed])).all(axis=0)
        bad = len(table) - int(np.count_nonzero(good))
        if not bad:
            kept[name] = table
            continue
        first = float(table.t[np.argmin(good)])
        said.append(
            f"{name}: {bad} of {len(table)} rows hold NaN or infinity, first at t = {first:.3f} s; left out"
        )
        if bad < len(table):
            rows = {column: values[good] for column, values in table.columns.items()}
            kept[name] = Table(rows, None if table.t_ns is None else table.t_ns[good])
    return kept, said


_LARGEST = 1e12
"""In any unit of a table: no sensor and no place reads more, and the square of what does may be infinite."""


def believable_tables(tables: Mapping[str, Table]) -> tuple[dict[str, Table], list[str]]:
    """The tables without rows of numbers that are too large to be any, and a line for each that had some."""
    kept, said = {}, []
    for name, table in tables.items():
        known = [*chain(*TABLE_FILE_COLUMNS.get(name, ((*NODE_COLUMNS, *NODE_OPTIONAL_COLUMNS), ())))]
        wild = np.zeros(len(table), bool)
        for column in known:
            if column in table and column != "t":
                wild |= np.abs(table[column]) > _LARGEST
        kept[name] = table
        if wild.any():
            first, count = float(table.t[np.argmax(wild)]), int(np.count_nonzero(wild))
            said.append(f"{name}: {count} rows hold numbers too large, first at t = {first:.3f} s; left out")
            rows = {column: values[~wild] for column, values in table.columns.items()}
            kept[name] = Table(rows, None if table.t_ns is None else table.t_ns[~wild])
    return kept, said
