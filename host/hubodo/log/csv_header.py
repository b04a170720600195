"""The header of a CSV table: its line below comments, the names of its columns, its faults."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import IO

from hubodo.errors import InputError
from hubodo.log.text_rows import is_utf16

MAX_LINE_BYTES = 1 << 20
"""Bytes; a longer line is not a row of numbers."""
MAX_COLUMNS = 1000
_MAX_PREAMBLE_LINES = 10_000  # lines of comments above the header


class ForeignHeaderError(InputError):
    """A header without the columns of the CSV folder, as of another program."""


def read_header(path: Path, stream: IO[bytes]) -> tuple[str, int]:
    """Return the header and its line number, and leave the stream behind it."""
    for number in count(1):
        raw = stream.readline(MAX_LINE_BYTES + 1)
        if not raw:
            break
        if len(raw) > MAX_LINE_BYTES or number > _MAX_PREAMBLE_LINES:
            raise InputError(f"{path}: row {number}: no header of a table in CSV; give a file with one")
        if number == 1 and is_utf16(raw):
            raise ForeignHeaderError(f"{path}: is UTF-16 text; save it as UTF-8")
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip()
        except UnicodeDecodeError:
            raise InputError(f"{path}: row {number}: is not UTF-8 text; convert the file") from None
        if text and not text.startswith("#"):
            return text, number
    raise InputError(f"{path}: is empty; give it a header row and data, or remove it")


def parse_header(path: Path, header: str, line: int, required: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns; `required`: those that must be among them."""
    try:
        names = tuple(name.strip() for name in next(csv.reader([header])))
    except csv.Error as error:
        raise InputError(f"{path}: row {line}: {explain_csv_error(error)}; save it again as CSV") from None
    if len(names) > MAX_COLUMNS:
        raise InputError(f"{path}: row {line}: {len(names)} columns, {MAX_COLUMNS} at most; split the file")
    missing = [name for name in required if name not in names]
    if missing:
        raise ForeignHeaderError(
            f"{path}: row {line}: no column {', '.join(missing)} in the header {header[:80]!r}; "
            f"the columns must include {','.join(required)}"
        )
    for name, times in Counter(names).items():
        if times > 1:
            raise InputError(f"{path}: row {line}: column {name!r} appears twice in the header; rename one")
    return names


def explain_csv_error(error: csv.Error) -> str:
    """Return the reason of an error in words."""
    text = str(error)
    if "new-line" in text:
        return "carriage returns without line feeds within it"
    return "a cell longer than any number" if "field larger" in text else text


def quote_name(name: str) -> str:
    """Return the name of a column as a cell of the header."""
    if any(character in name for character in ',"#'):
        return '"' + name.replace('"', '""') + '"'
    return name
