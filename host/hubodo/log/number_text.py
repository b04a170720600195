"""Read the numbers of a text file, gzipped or not, within the memory limit."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.clock_text import join_dates_and_times
from hubodo.log.column_names import parse_heading
from hubodo.log.input_limits import READ_BLOCK_BYTES, MemoryBudget
from hubodo.log.text_format import MISSING_NUMBERS, TextFormat, detect_format, is_number
from hubodo.log.text_rows import iterate_rows, open_stream

_NODE_HEADINGS = ("node", "sensor", "device", "imu", "wheel", "side", "sensor_id", "device_id", "node_id")
_ROWS_OF_NODES = 200  # rows in which the rows of each node occur
_BYTES_PER_CELL = 16  # a float64, and its copy while numpy joins blocks of rows


def read_text_table(path: Path) -> tuple[NDArray[np.float64], tuple[str, ...], tuple[str, ...]]:
    """Read rows of numbers; return (N, C) values, the column names, () without a header, and notes.

    Empty cells and words for a missing number become NaN. A last row that was cut off is left out. A row of
    units is added to the names, as in `gx (deg/s)`. Dates become seconds since 1970, times of day without a
    date seconds since midnight of the first day.

    Raises InputError for a file without numbers, a malformed row, text that is not UTF-8 or a table beyond
    the memory limit; OSError.
    """
    try:
        text_format = detect_format(path)
        _claim_table(path, text_format.width)
        _refuse_several_nodes(path, text_format)
        rows = (text for _, text in iterate_rows(path, text_format.first_row))
        delimiter = text_format.delimiter
        if text_format.decimal_comma or text_format.clocks or text_format.texts:
            rows, delimiter = (" ".join(text_format.cells(text)) for text in rows), None
        notes: list[str] = []
        try:
            values = np.loadtxt(rows, delimiter=delimiter, ndmin=2, comments=None, quotechar='"')
        except ValueError:
            try:
                repaired_rows = _repair_rows(path, text_format, notes)
                values = np.loadtxt(repaired_rows, delimiter=None, ndmin=2, comments=None)
            except ValueError:
                raise InputError(_describe_fault(path, text_format)) from None
        if values.shape[1] != text_format.width:  # all rows differ from the header in the same way
            raise InputError(_describe_fault(path, text_format))
    except (EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be unpacked ({error}); compress it again") from None
    join_dates_and_times(values, text_format.clocks)
    return values, _name_clock(text_format), tuple(notes)


def _refuse_several_nodes(path: Path, text_format: TextFormat) -> None:
    """Raise InputError if a column of words shows that the rows are of several nodes."""
    for column in text_format.texts:
        if text_format.names[column].strip().lower() not in _NODE_HEADINGS:
            continue
        rows = itertools.islice(iterate_rows(path, text_format.first_row), _ROWS_OF_NODES)
        cells = (text_format.raw_cells(row) for _, row in rows)
        nodes = dict.fromkeys(row[column] for row in cells if len(row) > column)
        if len(nodes) > 1:
            listed = ", ".join(list(nodes)[:4])
            raise InputError(
                f"{path}: its rows are of {len(nodes)} nodes ({listed}); write a file for each, such as "
                "left.csv and right.csv in one folder"
            )


def _repair_rows(path: Path, text_format: TextFormat, notes: list[str]) -> Iterator[str]:
    """Yield the rows with NaN for missing numbers; a last row without its end is left out and noted."""
    cut_off = ""
    for number, row in iterate_rows(path, text_format.first_row):
        if cut_off:
            raise ValueError("not the last row")
        cells = ["nan" if cell.lower() in MISSING_NUMBERS else cell for cell in text_format.cells(row)]
        if len(cells) < text_format.width:
            count = f"{len(cells)} of {text_format.width} columns"
            cut_off = f"{path}: row {number}, the last one, has {count}; left out"
        else:
            yield " ".join(cells)
    if cut_off and not _is_cut_off(path):
        raise ValueError("a complete row")
    notes += [cut_off] if cut_off else []


def _is_cut_off(path: Path) -> bool:
    """Return True if the last row of a file has no end."""
    last = b""
    with open_stream(path) as stream:
        while part := stream.read(READ_BLOCK_BYTES):
            last = part
    return not last.rstrip(b"\0").endswith((b"\n", b"\r"))


def _name_clock(text_format: TextFormat) -> tuple[str, ...]:
    """Return the names; if none of them is that of a time, the first column with times of day is `time`."""
    names = list(text_format.names)
    clock = next((column for column, its in text_format.clocks.items() if its.has_time), None)
    if names and clock is not None and all(parse_heading(name).name != "t" for name in names):
        names[clock] = "time"
    return tuple(names)


def _claim_table(path: Path, width: int) -> None:
    """Compare the number of rows with the memory limit before they are parsed.

    Counting the rows of an expanded file takes seconds, parsing them minutes.
    """
    budget = MemoryBudget(path)
    with open_stream(path) as stream:
        while part := stream.read(READ_BLOCK_BYTES):
            budget.claim(_BYTES_PER_CELL * width * max(part.count(b"\n"), part.count(b"\r")), "its table")


def _describe_fault(path: Path, text_format: TextFormat) -> str:
    """Describe the first malformed row."""
    for number, row in iterate_rows(path, text_format.first_row):
        cells = text_format.cells(row)
        if len(cells) != text_format.width:
            width = text_format.width
            return f"{path}: row {number} has {len(cells)} columns, the first {width}; correct the row"
        bad = next((cell.strip() for cell in cells if not is_number(cell)), None)
        if bad is not None and bad[:1].isalpha() and bad.endswith((":", "=")):
            return (
                f"{path}: row {number}: {bad[:40]!r} is a label beside each number; write a table, with the "
                "labels once above it"
            )
        if bad is not None:
            return f"{path}: row {number}: {bad[:40]!r} is not a number; correct the row, or write nan"
    return f"{path}: its rows are not numbers"
