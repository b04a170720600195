"""One table of a recording as a Parquet file, with the columns of the CSV file; needs pyarrow."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hubodo.errors import InputError
from hubodo.log.csv_table import (
    BEYOND,
    MOST_COLUMNS,
    NOT_FINITE,
    NOT_INCREASING,
    T_LIMIT,
    ParsedFile,
    longest_increasing,
)
from hubodo.log.input_limits import MemoryBudget, open_regular
from hubodo.recording import Table

MAGIC = b"PAR1"
_ROW_COPIES = 3  # of the numbers in memory: as Arrow has them, as one array, as columns
_THRIFT_LIMIT = 1 << 24  # bytes, and elements, of a file's description of itself


def is_parquet(path: Path) -> bool:
    """Return whether a file begins as Parquet does."""
    try:
        with open_regular(path) as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def read_table(path: Path, required: Sequence[str], *, repair: bool = False) -> ParsedFile:
    """Read one Parquet file. Numbers that are missing become NaN, which the required columns must not hold.

    Raises InputError with file, row and remedy: unreadable, a column missing or not of numbers, too large for
    the memory limit and, unless `repair` drops such rows: NaN, infinity, time not increasing.
    """
    arrow, parquet = _pyarrow(f"{path}: a Parquet file")
    try:
        with open_regular(path) as stream:
            limits = {
                "thrift_string_size_limit": _THRIFT_LIMIT,
                "thrift_container_size_limit": _THRIFT_LIMIT,
            }
            file = parquet.ParquetFile(stream, **limits)
            names = _numeric_columns(path, arrow, file.schema_arrow, required)
            n_rows = file.metadata.num_rows
            MemoryBudget(path).claim(_ROW_COPIES * 8 * len(names) * n_rows, "the table")
            table = file.read(columns=list(names), use_threads=False)
            columns = [_numbers(table.column(name)) for name in names]
    except (arrow.ArrowException, ValueError, OSError, MemoryError, OverflowError) as error:
        reason = str(error).partition("\n")[0][:200]
        raise InputError(f"{path}: cannot be read as Parquet ({reason}); write it again") from None
    return _checked(path, dict(zip(names, columns, strict=True)), required, repair)


def write_table(path: Path, table: Table) -> None:
    """Write a table. Raises InputError where pyarrow is not installed."""
    arrow, parquet = _pyarrow("--format parquet")
    parquet.write_table(arrow.table({name: table[name] for name in table}), path)


def require_pyarrow() -> None:
    """Raise InputError where pyarrow is not installed."""
    _pyarrow("--format parquet")


def _numeric_columns(path: Path, arrow: Any, schema: Any, required: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns that hold numbers."""
    repeated = [name for name, times in Counter(schema.names).items() if times > 1]
    if repeated or len(schema.names) > MOST_COLUMNS:
        what = f"column {repeated[0]!r} twice" if repeated else f"{len(schema.names)} columns"
        raise InputError(f"{path}: has {what}; write it with up to {MOST_COLUMNS} different ones")
    numeric = [
        field.name
        for field in schema
        if arrow.types.is_floating(field.type) or arrow.types.is_integer(field.type)
    ]
    if missing := [name for name in required if name not in numeric]:
        raise InputError(
            f"{path}: no column of numbers {', '.join(missing)}; it must have {','.join(required)}"
        )
    return tuple(numeric)


def _numbers(column: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.asarray(column.to_numpy(), np.float64)


def _checked(path: Path, columns: dict[str, Any], required: Sequence[str], repair: bool) -> ParsedFile:
    """Check rows as those of a CSV file are; rows are counted from 1."""
    if len({len(values) for values in columns.values()}) > 1:
        raise InputError(f"{path}: its columns differ in length; write it again")
    t = columns["t"]
    finite = np.isfinite(np.stack([columns[name] for name in required])).all(axis=0)
    faults = {NOT_FINITE: ~finite, BEYOND: finite & ~(np.abs(t) < T_LIMIT)}
    faulty = faults[NOT_FINITE] | faults[BEYOND]
    dropped = Counter({kind: int(np.count_nonzero(rows)) for kind, rows in faults.items() if rows.any()})
    if dropped and not repair:
        kind = next(iter(dropped))
        _refuse(path, int(np.argmax(faults[kind])), kind)
    kept = np.flatnonzero(~faulty)
    if len(kept) > 1 and not bool((np.diff(t[kept]) > 0).all()):
        if not repair:
            _refuse(path, int(np.argmax(np.diff(t) <= 0)) + 1, NOT_INCREASING)
        increasing = longest_increasing(t[kept])
        dropped[NOT_INCREASING] += len(kept) - len(increasing)
        kept = kept[increasing]
    return ParsedFile(Table({name: values[kept] for name, values in columns.items()}), dict(dropped))


def _refuse(path: Path, row: int, kind: str) -> None:
    raise InputError(
        f"{path}: row {row + 1}: {kind}; correct it, or drop such rows with hubodo import --repair"
    )


def _pyarrow(what: str) -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError(
            f"{what} needs pyarrow, which is missing; pip install 'hubodo[parquet]', or use csv"
        ) from None
