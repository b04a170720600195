"""Read numbers in rows of text, gzipped or not, within the memory limit.

Decimal commas, dates and times of day, quotation marks, a row of units below the header, lines of text above
it and a header that is marked as a comment are recognised by the first rows.
"""

from __future__ import annotations

import codecs
import gzip
import io
import itertools
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.clock_text import ClockFormat, clock_format, join_dates_and_times
from hubodo.log.column_names import is_unit, parse_heading
from hubodo.log.input_limits import READ_BLOCK_BYTES, MemoryBudget, open_regular

_GZIP_MAGIC = b"\x1f\x8b"
_DELIMITERS = (";", "\t", ",")
"""A comma may be a decimal comma where a row has another delimiter."""
_COMMENT_MARKS = "#%"
_COMMENT_STARTS = (*_COMMENT_MARKS, "//")
_MAX_PREAMBLE_ROWS = 40  # rows of text above a header, its units and the first numbers
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_HEAD_BYTES = 4096
_MISSING_NUMBERS = ("", "na", "n/a", "#n/a", "null", "none", "-", "--")
"""Cells of programs that have no number there, in lower case; `nan` is a number of Python."""
_MAX_ROW_CHARS = 1 << 20  # a longer row does not consist of numbers
_BYTES_PER_CELL = 16  # a float64, and its copy while numpy joins blocks of rows
NumberedRow = tuple[int, str]
"""Row number in the file, counted from 1, and text of the row."""


@dataclass(frozen=True)
class _TextFormat:
    """The format of a text file.

    delimiter: None for white space. names: names of the columns, or empty. first_row: number of the first row
    of data.
    decimal_comma: True for numbers such as 0,5. clocks: formats of the columns with dates or times of day.
    texts: indices of columns with words, such as the name of a frame, which become NaN.
    """

    delimiter: str | None
    width: int
    names: tuple[str, ...]
    first_row: int
    decimal_comma: bool = False
    clocks: Mapping[int, ClockFormat] = field(default_factory=dict)
    texts: tuple[int, ...] = ()

    def cells(self, row: str) -> list[str]:
        """Return the cells of a row with decimal points, and dates and times of day in seconds.

        A delimiter behind the last cell adds none.
        """
        cells = _split(row, self.delimiter)
        if len(cells) == self.width + 1 and not cells[-1]:
            del cells[-1]
        for column, clock in self.clocks.items():
            if column < len(cells):
                cells[column] = clock.seconds(cells[column])
        for column in self.texts:
            if column < len(cells):
                cells[column] = "nan"
        return [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells


def read_text_table(path: Path) -> tuple[NDArray[np.float64], tuple[str, ...], tuple[str, ...]]:
    """Read rows of numbers; return (N, C) values, the column names, () without a header, and notes.

    Empty cells and words for a missing number become NaN. A last row that was cut off is left out. A row of
    units is added to the names, as in `gx (deg/s)`. Dates become seconds since 1970, times of day without a
    date seconds since midnight of the first day.

    Raises InputError for a file without numbers, a malformed row, text that is not UTF-8 or a table beyond
    the memory limit; OSError.
    """
    try:
        text_format = _detect_format(path)
        _claim_table(path, text_format.width)
        rows = (text for _, text in _iterate_rows(path, text_format.first_row))
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


def _repair_rows(path: Path, text_format: _TextFormat, notes: list[str]) -> Iterator[str]:
    """Yield the rows with NaN for missing numbers; a last row without its end is left out and noted."""
    cut_off = ""
    for number, row in _iterate_rows(path, text_format.first_row):
        if cut_off:
            raise ValueError("not the last row")
        cells = ["nan" if cell.lower() in _MISSING_NUMBERS else cell for cell in text_format.cells(row)]
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
    with _open_stream(path) as stream:
        while part := stream.read(READ_BLOCK_BYTES):
            last = part
    return not last.rstrip(b"\0").endswith((b"\n", b"\r"))


def _name_clock(text_format: _TextFormat) -> tuple[str, ...]:
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
    with _open_stream(path) as stream:
        while part := stream.read(READ_BLOCK_BYTES):
            budget.claim(_BYTES_PER_CELL * width * max(part.count(b"\n"), part.count(b"\r")), "its table")


def _detect_format(path: Path) -> _TextFormat:
    rows = list(itertools.islice(_iterate_rows(path), _MAX_PREAMBLE_ROWS))
    if not rows:
        raise InputError(f"{path}: holds no numbers")
    number, first = rows[0]
    delimiter = _delimiter(first)
    cells = _split(first, delimiter)
    names = _commented_names(path, delimiter, len(cells))
    if (without_header := _recognise(cells, delimiter, number, names)) is not None:
        return without_header
    widths = [len(_split(row.rstrip(" ,;\t"), _delimiter(row))) for _, row in rows]
    candidates = []
    for at in range(len(rows) - 1):
        if (with_names := _recognise_header(path, rows, at)) is not None:
            # Wider rows follow the names and values of a preamble.
            if max(widths[at:]) <= with_names.width:
                return with_names
            candidates.append(with_names)
    if candidates:
        return candidates[0]
    if len(rows) == 1:
        raise InputError(f"{path}: no row below the header")
    return _TextFormat(delimiter, len(cells), tuple(cells), rows[1][0])


def _recognise_header(path: Path, rows: Sequence[NumberedRow], at: int) -> _TextFormat | None:
    """Return the format if `rows[at]` is a header, followed by as many numbers or by their units."""
    delimiter = _delimiter(rows[at][1])
    names, below = tuple(_split(rows[at][1], delimiter)), _split(rows[at + 1][1], delimiter)
    if at and (len(names) < 2 or len(names) != len(below)):
        return None
    first_row = at + 1
    if len(below) == len(names) and any(below) and all(is_unit(it) and not _is_number(it) for it in below):
        names = tuple(
            f"{name} ({unit.strip('[]() ')})" if unit.strip("[]()- ") else name
            for name, unit in zip(names, below, strict=True)
        )
        first_row += 1
        if first_row == len(rows):
            raise InputError(f"{path}: no row below the units")
    number, row = rows[first_row]
    return _recognise(_split(row, delimiter), delimiter, number, names)


def _commented_names(path: Path, delimiter: str | None, width: int) -> tuple[str, ...]:
    """Return the names of a header that begins with # or %, as of EuRoC and rostopic; () if there is none."""
    last = ""
    with _open_text(path) as text:
        while (line := text.readline(_MAX_ROW_CHARS)) and (
            not line.strip() or line.strip()[0] in _COMMENT_MARKS
        ):
            last = line.strip() or last
    names = _split(last.lstrip(_COMMENT_MARKS + " "), delimiter)
    are_names = len(names) == width > 1 and not any(map(_is_number, names))
    return tuple(names) if are_names and all(names) else ()


def _delimiter(row: str) -> str | None:
    return next((mark for mark in _DELIMITERS if mark in row), None)


def _split(row: str, delimiter: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in row.split(delimiter)]


def _recognise(
    cells: list[str], delimiter: str | None, number: int, names: tuple[str, ...]
) -> _TextFormat | None:
    """Return the format by the cells of the first row of data; None if they are neither numbers nor dates."""
    if len(cells) == len(names) + 1 and not cells[-1]:
        cells = cells[:-1]
    clocks = {
        column: its
        for column, cell in enumerate(cells)
        if not _is_number(cell) and (its := clock_format(cell)) is not None
    }
    texts = tuple(
        column
        for column, (cell, name) in enumerate(zip(cells, names, strict=False))
        if column not in clocks and _is_word(cell) and not parse_heading(name).name
    )
    others = [
        cell
        for column, cell in enumerate(cells)
        if column not in (*clocks, *texts) and cell.lower() not in _MISSING_NUMBERS
    ]
    decimal_comma = delimiter != "," and not all(_is_number(cell) for cell in others)
    if decimal_comma and not all(_is_number(cell.replace(",", ".", 1)) for cell in others):
        return None
    if not (others or clocks) or not (decimal_comma or all(_is_number(cell) for cell in others)):
        return None
    return _TextFormat(delimiter, len(names) or len(cells), names, number, decimal_comma, clocks, texts)


def _is_word(cell: str) -> bool:
    """Return True for text such as a name or a date in words, not for a number with a decimal comma."""
    is_missing = cell.lower() in _MISSING_NUMBERS
    return not is_missing and not _is_number(cell) and not _is_number(cell.replace(",", ".", 1))


def _iterate_rows(path: Path, first: int = 1) -> Iterator[NumberedRow]:
    """Yield the rows from number `first` on, without blanks and comments. Raises InputError if not text."""
    with _open_text(path) as text:
        number = 0
        try:
            while line := text.readline(_MAX_ROW_CHARS + 1):
                number += 1
                if len(line) > _MAX_ROW_CHARS:
                    raise InputError(
                        f"{path}: row {number} is longer than {_MAX_ROW_CHARS} characters; split it"
                    )
                content = line.strip()
                if number >= first and content and not content.startswith(_COMMENT_STARTS):
                    yield number, content
        except UnicodeDecodeError:
            raise InputError(
                f"{path}: row {number + 1} or the rows after it are not UTF-8 text; convert the file, and "
                "unpack it where it is a compressed file of another kind"
            ) from None


@contextmanager
def _open_text(path: Path) -> Iterator[io.TextIOWrapper]:
    with _open_stream(path) as stream:
        encoding = _encoding(stream.peek(_HEAD_BYTES)[:_HEAD_BYTES])
        yield io.TextIOWrapper(stream, encoding)


def _encoding(head: bytes) -> str:
    """Return the encoding by the first bytes: that of Windows if letters of the header are not UTF-8."""
    if head.startswith(_UTF16_MARKS):
        return "utf-16"
    if bare := unmarked_utf16(head):
        return bare
    header = re.split(rb"[\r\n]+[-+ \t]*\d", head)[0]
    try:
        header.decode("utf-8-sig")
    except UnicodeDecodeError:
        return "utf-8-sig" if b"\0" in head else "cp1252"
    return "utf-8-sig"


def is_utf16(head: bytes) -> bool:
    """Return True if the first bytes are those of UTF-16, with or without a byte order mark."""
    return head.startswith(_UTF16_MARKS) or bool(unmarked_utf16(head))


def unmarked_utf16(head: bytes) -> str:
    """Return the encoding of UTF-16 without a byte order mark, of which every other byte is 0; else ""."""
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        zeros, others = head[first::2], head[1 - first :: 2]
        if len(head) > 1 and zeros.count(0) > 0.9 * len(zeros) and not others.count(0):
            return encoding
    return ""


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
