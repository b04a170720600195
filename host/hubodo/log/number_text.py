"""Numbers in rows of text, gzipped or not, read row by row within the memory limit."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.input_limits import MemoryBudget, open_regular

_GZIP = b"\x1f\x8b"
_DELIMITERS = (",", ";", "\t")
_LONGEST_ROW = 1 << 20  # characters; a longer one is no row of numbers
_BYTES_PER_CELL = 16  # a float64, and its copy while numpy joins blocks of rows
_PORTION = 1 << 20  # bytes
Row = tuple[int, str]
"""Number of a row in the file, counted from 1, and its text."""


@dataclass(frozen=True)
class _Form:
    """How the rows of a file are written.

    names: of the columns, or empty. first: number of the first row of data.
    """

    delimiter: str | None
    width: int
    names: tuple[str, ...]
    first: int


def read_text(path: Path) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Read rows of numbers: (N, C), and the names in the header or ().

    Raises InputError: no numbers, a row that is not one, not UTF-8, more than the memory limit. OSError.
    """
    try:
        form = _form(path)
        _claim_table(path, form.width)
        rows = (text for _, text in _rows(path, form.first))
        try:
            values = np.loadtxt(rows, delimiter=form.delimiter, ndmin=2, comments=None)
        except ValueError:
            raise InputError(_fault(path, form)) from None
        if values.shape[1] != form.width:  # all rows differ from the header in the same way
            raise InputError(_fault(path, form))
    except (EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be unpacked ({error}); compress it again") from None
    return values, form.names


def _claim_table(path: Path, width: int) -> None:
    """Compare the number of rows with the memory limit before they are parsed.

    Counting takes seconds where parsing what a compressed file expands to would take minutes.
    """
    budget = MemoryBudget(path)
    with _stream(path) as stream:
        while part := stream.read(_PORTION):
            budget.claim(_BYTES_PER_CELL * width * max(part.count(b"\n"), part.count(b"\r")), "its table")


def _form(path: Path) -> _Form:
    rows = _rows(path)
    number, first = next(rows, (0, ""))
    if not number:
        raise InputError(f"{path}: holds no numbers")
    delimiter = next((mark for mark in _DELIMITERS if mark in first), None)
    cells = [cell.strip().strip('"') for cell in first.split(delimiter)]
    if all(_is_number(cell) for cell in cells):
        return _Form(delimiter, len(cells), (), number)
    number, _ = next(rows, (0, ""))
    if not number:
        raise InputError(f"{path}: no row below the header")
    return _Form(delimiter, len(cells), tuple(cells), number)


def _rows(path: Path, first: int = 1) -> Iterator[Row]:
    """Yield the rows from number `first` on without blank ones and comments. Raises InputError: not text."""
    with _stream(path) as stream:
        text = io.TextIOWrapper(stream, "utf-8-sig")
        number = 0
        try:
            while line := text.readline(_LONGEST_ROW + 1):
                number += 1
                if len(line) > _LONGEST_ROW:
                    raise InputError(
                        f"{path}: row {number} is longer than {_LONGEST_ROW} characters; split it"
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
def _stream(path: Path) -> Iterator[gzip.GzipFile | io.BufferedReader]:
    with open_regular(path) as file:
        packed = file.read(2) == _GZIP
        file.seek(0)
        if packed:
            with gzip.GzipFile(fileobj=file) as stream:
                yield stream
        else:
            yield io.BufferedReader(cast(io.RawIOBase, file))


def _fault(path: Path, form: _Form) -> str:
    """Return the error for the first row that is not like the others."""
    for number, row in _rows(path, form.first):
        cells = row.split(form.delimiter)
        if len(cells) != form.width:
            return f"{path}: row {number} has {len(cells)} columns, the first {form.width}; correct the row"
        bad = next((cell.strip() for cell in cells if not _is_number(cell)), None)
        if bad is not None:
            return f"{path}: row {number}: {bad[:40]!r} is not a number; correct the row, or write nan"
    return f"{path}: its rows are no numbers"


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
