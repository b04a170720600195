"""Format of a text file of numbers, recognised by its first rows.

Decimal commas, dates and times of day, quotation marks, a row of units below the header, lines of text above
it and a header that is marked as a comment are recognised.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.clock_text import ClockFormat, clock_format
from hubodo.log.column_names import is_unit, parse_heading
from hubodo.log.text_rows import COMMENT_MARKS, MAX_ROW_CHARS, NumberedRow, iterate_rows, open_text

_DELIMITERS = (";", "\t", ",")
"""A comma may be a decimal comma where a row has another delimiter."""
_MAX_PREAMBLE_ROWS = 40  # rows of text above a header, its units and the first numbers
MISSING_NUMBERS = ("", "na", "n/a", "#n/a", "null", "none", "-", "--")
"""Cells of programs that have no number there, in lower case; `nan` is a number of Python."""


@dataclass(frozen=True)
class TextFormat:
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

    def raw_cells(self, row: str) -> list[str]:
        """Return the cells of a row as written."""
        cells = _split(row, self.delimiter)
        if len(cells) == self.width + 1 and not cells[-1]:
            del cells[-1]
        return cells

    def cells(self, row: str) -> list[str]:
        """Return the cells of a row with decimal points, and dates and times of day in seconds.

        A delimiter behind the last cell adds none.
        """
        cells = self.raw_cells(row)
        for column, clock in self.clocks.items():
            if column < len(cells):
                cells[column] = clock.seconds(cells[column])
        for column in self.texts:
            if column < len(cells):
                cells[column] = "nan"
        return [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells


def detect_format(path: Path) -> TextFormat:
    """Return the format of a file. Raises InputError if it holds no rows of numbers."""
    rows = list(itertools.islice(iterate_rows(path), _MAX_PREAMBLE_ROWS))
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
    return TextFormat(delimiter, len(cells), tuple(cells), rows[1][0])


def _recognise_header(path: Path, rows: Sequence[NumberedRow], at: int) -> TextFormat | None:
    """Return the format if `rows[at]` is a header, followed by as many numbers or by their units."""
    delimiter = _delimiter(rows[at][1])
    names, below = tuple(_split(rows[at][1], delimiter)), _split(rows[at + 1][1], delimiter)
    if at and (len(names) < 2 or len(names) != len(below)):
        return None
    first_row = at + 1
    if len(below) == len(names) and any(below) and all(is_unit(it) and not is_number(it) for it in below):
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
    with open_text(path) as text:
        while (line := text.readline(MAX_ROW_CHARS)) and (
            not line.strip() or line.strip()[0] in COMMENT_MARKS
        ):
            last = line.strip() or last
    names = _split(last.lstrip(COMMENT_MARKS + " "), delimiter)
    are_names = len(names) == width > 1 and not any(map(is_number, names))
    return tuple(names) if are_names and all(names) else ()


def _delimiter(row: str) -> str | None:
    return next((mark for mark in _DELIMITERS if mark in row), None)


def _split(row: str, delimiter: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in row.split(delimiter)]


def _recognise(
    cells: list[str], delimiter: str | None, number: int, names: tuple[str, ...]
) -> TextFormat | None:
    """Return the format by the cells of the first row of data; None if they are neither numbers nor dates."""
    if len(cells) == len(names) + 1 and not cells[-1]:
        cells = cells[:-1]
    clocks = {
        column: its
        for column, cell in enumerate(cells)
        if not is_number(cell) and (its := clock_format(cell)) is not None
    }
    texts = tuple(
        column
        for column, (cell, name) in enumerate(zip(cells, names, strict=False))
        if column not in clocks and _is_word(cell) and not parse_heading(name).name
    )
    others = [
        cell
        for column, cell in enumerate(cells)
        if column not in (*clocks, *texts) and cell.lower() not in MISSING_NUMBERS
    ]
    decimal_comma = delimiter != "," and not all(is_number(cell) for cell in others)
    if decimal_comma and not all(is_number(cell.replace(",", ".", 1)) for cell in others):
        return None
    if not (others or clocks) or not (decimal_comma or all(is_number(cell) for cell in others)):
        return None
    return TextFormat(delimiter, len(names) or len(cells), names, number, decimal_comma, clocks, texts)


def _is_word(cell: str) -> bool:
    """Return True for text such as a name or a date in words, not for a number with a decimal comma."""
    is_missing = cell.lower() in MISSING_NUMBERS
    return not is_missing and not is_number(cell) and not is_number(cell.replace(",", ".", 1))


def is_number(cell: str) -> bool:
    """Return True if Python reads the cell as a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
