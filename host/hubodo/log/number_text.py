"""Read numbers in rows of text, gzipped or not, within the memory limit.

Decimal commas, dates in ISO 8601 and a row of units below the header are recognised by the first rows.
"""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.column_names import is_unit
from hubodo.log.input_limits import READ_BLOCK_BYTES, MemoryBudget, open_regular

_GZIP_MAGIC = b"\x1f\x8b"
_DELIMITERS = (";", "\t", ",")
"""A comma may be a decimal comma where a row has another delimiter."""
_EPOCH, _MICROSECOND = datetime(1970, 1, 1, tzinfo=UTC), timedelta(microseconds=1)
_MAX_ROW_CHARS = 1 << 20  # a longer row does not consist of numbers
_BYTES_PER_CELL = 16  # a float64, and its copy while numpy joins blocks of rows
NumberedRow = tuple[int, str]
"""Row number in the file, counted from 1, and text of the row."""


@dataclass(frozen=True)
class _TextFormat:
    """The format of a text file.

    delimiter: None for white space. names: names of the columns, or empty. first_row: number of the first row
    of data.
    decimal_comma: True for numbers such as 0,5. dates: indices of columns with dates in ISO 8601.
    """

    delimiter: str | None
    width: int
    names: tuple[str, ...]
    first_row: int
    decimal_comma: bool = False
    dates: tuple[int, ...] = ()

    def cells(self, row: str) -> list[str]:
        """Return the cells of a row with decimal points, and dates as seconds since 1970 in UTC."""
        cells = [cell.strip().strip('"') for cell in row.split(self.delimiter)]
        for column in self.dates:
            if column < len(cells):
                cells[column] = _seconds_of_date(cells[column])
        return [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells


def read_text_table(path: Path) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Read rows of numbers; return (N, C) values and the column names, () without a header.

    A row of units is added to the names, as in `gx (deg/s)`. Dates become seconds since 1970.

    Raises InputError for a file without numbers, a malformed row, text that is not UTF-8 or a table beyond
    the memory limit; OSError.
    """
    try:
        text_format = _detect_format(path)
        _claim_table(path, text_format.width)
        rows = (text for _, text in _iterate_rows(path, text_format.first_row))
        delimiter = text_format.delimiter
        if text_format.decimal_comma or text_format.dates:
            rows, delimiter = (" ".join(text_format.cells(text)) for text in rows), None
        try:
            values = np.loadtxt(rows, delimiter=delimiter, ndmin=2, comments=None)
        except ValueError:
            raise InputError(_describe_fault(path, text_format)) from None
        if values.shape[1] != text_format.width:  # all rows differ from the header in the same way
            raise InputError(_describe_fault(path, text_format))
    except (EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be unpacked ({error}); compress it again") from None
    return values, text_format.names


def _claim_table(path: Path, width: int) -> None:
    """Compare the number of rows with the memory limit before they are parsed.

    Counting the rows of an expanded file takes seconds, parsing them minutes.
    """
    budget = MemoryBudget(path)
    with _open_stream(path) as stream:
        while part := stream.read(READ_BLOCK_BYTES):
            budget.claim(_BYTES_PER_CELL * width * max(part.count(b"\n"), part.count(b"\r")), "its table")


def _detect_format(path: Path) -> _TextFormat:
    rows = _iterate_rows(path)
    number, first = next(rows, (0, ""))
    if not number:
        raise InputError(f"{path}: holds no numbers")
    delimiter = next((mark for mark in _DELIMITERS if mark in first), None)
    cells = _split(first, delimiter)
    if (without_names := _recognise(cells, delimiter, number, ())) is not None:
        return without_names
    number, row = next(rows, (0, ""))
    if not number:
        raise InputError(f"{path}: no row below the header")
    names, units = tuple(cells), _split(row, delimiter)
    if len(units) == len(names) and any(units) and all(is_unit(it) and not _is_number(it) for it in units):
        names = tuple(
            f"{name} ({unit.strip('[]() ')})" if unit.strip("[]()- ") else name
            for name, unit in zip(names, units, strict=True)
        )
        number, row = next(rows, (0, ""))
        if not number:
            raise InputError(f"{path}: no row below the units")
    recognised = _recognise(_split(row, delimiter), delimiter, number, names)
    return recognised or _TextFormat(delimiter, len(names), names, number)


def _split(row: str, delimiter: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in row.split(delimiter)]


def _recognise(
    cells: list[str], delimiter: str | None, number: int, names: tuple[str, ...]
) -> _TextFormat | None:
    """Return the format by the cells of the first row of data; None if they are neither numbers nor dates."""
    dates = tuple(column for column, cell in enumerate(cells) if not _is_number(cell) and _is_date(cell))
    others = [cell for column, cell in enumerate(cells) if column not in dates]
    decimal_comma = delimiter != "," and not all(_is_number(cell) for cell in others)
    if decimal_comma and not all(_is_number(cell.replace(",", ".", 1)) for cell in others):
        return None
    if not decimal_comma and not all(_is_number(cell) for cell in others):
        return None
    return _TextFormat(delimiter, len(names) or len(cells), names, number, decimal_comma, dates)


def _is_date(cell: str) -> bool:
    try:
        datetime.fromisoformat(cell)
    except ValueError:
        return False
    return not cell.isdigit()


def _seconds_of_date(cell: str) -> str:
    """Return an ISO date as seconds since 1970; a date without a zone is in UTC. Other text is unchanged."""
    try:
        date = datetime.fromisoformat(cell)
    except ValueError:
        return cell
    elapsed = (date if date.tzinfo else date.replace(tzinfo=UTC)) - _EPOCH
    return f"{elapsed // _MICROSECOND}e-6"


def _iterate_rows(path: Path, first: int = 1) -> Iterator[NumberedRow]:
    """Yield the rows from number `first` on, without blanks and comments. Raises InputError if not text."""
    with _open_stream(path) as stream:
        text = io.TextIOWrapper(stream, "utf-8-sig")
        number = 0
        try:
            while line := text.readline(_MAX_ROW_CHARS + 1):
                number += 1
                if len(line) > _MAX_ROW_CHARS:
                    raise InputError(
                        f"{path}: row {number} is longer than {_MAX_ROW_CHARS} characters; split it"
                    )
                content = line.strip()
                if number >= first and content and content[0] not in "#%":
                    yield number, content
        except UnicodeDecodeError:
            raise InputError(
                f"{path}: row {number + 1} or the rows after it are not UTF-8 text; convert the file, and "
                "unpack it where it is a compressed file of another kind"
            ) from None


@contextmanager
def _open_stream(path: Path) -> Iterator[gzip.GzipFile | io.BufferedReader]:
    with open_regular(path) as file:
        packed = file.read(2) == _GZIP_MAGIC
        file.seek(0)
        if packed:
            with gzip.GzipFile(fileobj=file) as stream:
                yield stream
        else:
            yield io.BufferedReader(cast(io.RawIOBase, file))


def _describe_fault(path: Path, text_format: _TextFormat) -> str:
    """Describe the first malformed row."""
    for number, row in _iterate_rows(path, text_format.first_row):
        cells = text_format.cells(row)
        if len(cells) != text_format.width:
            width = text_format.width
            return f"{path}: row {number} has {len(cells)} columns, the first {width}; correct the row"
        bad = next((cell.strip() for cell in cells if not _is_number(cell)), None)
        if bad is not None:
            return f"{path}: row {number}: {bad[:40]!r} is not a number; correct the row, or write nan"
    return f"{path}: its rows are not numbers"


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
