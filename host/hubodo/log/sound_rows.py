"""Rows of a log with NaN or infinity in them: left out and told, so that what they leave is a gap."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hubodo.recording import NODE_COLUMNS, RESERVED, Table


def sound_tables(tables: Mapping[str, Table]) -> tuple[dict[str, Table], list[str]]:
    """The tables without such rows, by name, and a line for each that had any.

    A table of nothing else is dropped. Only what a table must have counts: a temperature or a sigma that is
    not known stays as it is.
    """
    kept, said = {}, []
    for name, table in tables.items():
        needed = [column for column in RESERVED.get(name, (NODE_COLUMNS,))[0] if column in table]
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
