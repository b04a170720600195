"""Read and write one table of a recording as a Parquet file; needs pyarrow."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hubodo.errors import InputError
from hubodo.log.csv_header import MAX_COLUMNS
from hubodo.log.csv_table import (
    MAX_TIME_S,
    NOT_FINITE,
    NOT_INCREASING,
    TIME_OUT_OF_RANGE,
    ParsedFile,
    longest_increasing_rows,
)
from hubodo.log.input_limits import MemoryBudget, open_regular
from hubodo.recording import Table

MAGIC = b"PAR1"
TABLE_COPIES = 3  # copies of the numbers in memory: Arrow's, one array, columns
_MAX_THRIFT_BYTES = 1 << 24  # limit of bytes and of elements of the file's metadata


def is_parquet(path: Path) -> bool:
    """Return True if a file begins with the magic bytes of Parquet."""
    try:
        with open_regular(path) as stream:
            return stream.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def read_table(path: Path, required: Sequence[str], *, repair: bool = False) -> ParsedFile:
    """Read one Parquet file. Missing numbers become NaN, which required columns must not contain.

    Raises InputError with file, row and remedy if the file is unreadable, lacks a numeric column or exceeds
    the memory limit; and, unless `repair` drops such rows, for NaN, infinity and time that does not increase.
    """
    with _open_file(path) as (arrow, file):
        names = _numeric_columns(path, arrow, file.schema_arrow, required)
        n_rows = file.metadata.num_rows
        MemoryBudget(path).claim(TABLE_COPIES * 8 * len(names) * n_rows, "the table")
        table = file.read(columns=list(names), use_threads=False)
        columns = [_to_float_array(table.column(name)) for name in names]
    return _check_rows(path, dict(zip(names, columns, strict=True)), required, repair)


def has_columns(path: Path, names: Sequence[str]) -> bool:
    """Return True if a Parquet file has all these columns. Raises InputError if it is unreadable."""
    with _open_file(path) as (_, file):
        return set(names) <= set(file.schema_arrow.names)


def read_numeric_columns(path: Path) -> tuple[tuple[str, ...], np.ndarray[Any, np.dtype[np.float64]]]:
    """Return the names of the columns with numbers or dates, and their values (N, C); missing ones are NaN.

    Dates become seconds since 1970. Raises InputError for an unreadable file, a file without numbers, or one
    beyond the memory limit.
    """
    with _open_file(path) as (arrow, file):
        schema = file.schema_arrow
        dates = {field.name for field in schema if arrow.types.is_timestamp(field.type)}
        names = tuple(
            name for name in schema.names if name in {*_numeric_columns(path, arrow, schema, ()), *dates}
        )
        if not names:
            raise InputError(f"{path}: holds no column of numbers")
        MemoryBudget(path).claim(TABLE_COPIES * 8 * len(names) * file.metadata.num_rows, "the table")
        table = file.read(columns=list(names), use_threads=False)
        columns = []
        for name in names:
            column = table.column(name)
            if name in dates:
                column = column.cast(arrow.timestamp("ns")).cast(arrow.int64())
            values = _to_float_array(column)
            columns.append(values * 1e-9 if name in dates else values)
    return names, np.column_stack(columns)


@contextmanager
def _open_file(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a Parquet file; yield pyarrow and the file. Raises InputError if it is unreadable."""
    arrow, parquet = _import_pyarrow(f"{path}: a Parquet file")
    try:
        with open_regular(path) as stream:
            limits = {
                "thrift_string_size_limit": _MAX_THRIFT_BYTES,
                "thrift_container_size_limit": _MAX_THRIFT_BYTES,
            }
            yield arrow, parquet.ParquetFile(stream, **limits)
    except (arrow.ArrowException, ValueError, OSError, MemoryError, OverflowError) as error:
        reason = str(error).partition("\n")[0][:200]
        raise InputError(f"{path}: cannot be read as Parquet ({reason}); write it again") from None


def write_table(path: Path, table: Table) -> None:
    """Write a table. Raises InputError if pyarrow is not installed."""
    arrow, parquet = _import_pyarrow("--format parquet")
    parquet.write_table(arrow.table({name: table[name] for name in table}), path)


def require_pyarrow() -> None:
    """Raise InputError if pyarrow is not installed."""
    _import_pyarrow("--format parquet")


def _numeric_columns(path: Path, arrow: Any, schema: Any, required: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the numeric columns."""
    repeated = [name for name, times in Counter(schema.names).items() if times > 1]
    if repeated or len(schema.names) > MAX_COLUMNS:
        what = f"column {repeated[0]!r} twice" if repeated else f"{len(schema.names)} columns"
        raise InputError(f"{path}: has {what}; write it with up to {MAX_COLUMNS} different ones")
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


def _to_float_array(column: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.asarray(column.to_numpy(), np.float64)


def _check_rows(path: Path, columns: dict[str, Any], required: Sequence[str], repair: bool) -> ParsedFile:
    """Check the rows as those of a CSV file, counted from 1."""
    if len({len(values) for values in columns.values()}) > 1:
        raise InputError(f"{path}: its columns differ in length; write it again")
    t = columns["t"]
    finite = np.isfinite(np.stack([columns[name] for name in required])).all(axis=0)
    faults = {NOT_FINITE: ~finite, TIME_OUT_OF_RANGE: finite & ~(np.abs(t) < MAX_TIME_S)}
    faulty = faults[NOT_FINITE] | faults[TIME_OUT_OF_RANGE]
    dropped = Counter({kind: int(np.count_nonzero(rows)) for kind, rows in faults.items() if rows.any()})
    if dropped and not repair:
        kind = next(iter(dropped))
        _raise_row_error(path, int(np.argmax(faults[kind])), kind)
    valid_rows = np.flatnonzero(~faulty)
    if len(valid_rows) > 1 and not bool((np.diff(t[valid_rows]) > 0).all()):
        if not repair:
            _raise_row_error(path, int(np.argmax(np.diff(t) <= 0)) + 1, NOT_INCREASING)
        increasing = longest_increasing_rows(t[valid_rows])
        dropped[NOT_INCREASING] += len(valid_rows) - len(increasing)
        valid_rows = valid_rows[increasing]
    return ParsedFile(Table({name: values[valid_rows] for name, values in columns.items()}), dict(dropped))


def _raise_row_error(path: Path, row: int, kind: str) -> None:
    raise InputError(
        f"{path}: row {row + 1}: {kind}; correct it, or drop such rows with hubodo import --repair"
    )


def _import_pyarrow(purpose: str) -> tuple[Any, Any]:
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError(
            f"{purpose} needs pyarrow, which is missing; pip install 'hubodo[parquet]', or use csv"
        ) from None
