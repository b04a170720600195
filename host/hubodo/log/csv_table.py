"""Read one CSV file strictly into columns, with the row of each fault, and write it back.

Rows are identified by their line number, counted from 1 as in an editor. Blocks that contain only numbers are
parsed at once; a block with anything else in it is parsed line by line to locate the fault.
"""

from __future__ import annotations

import csv
import gzip
import io
import math
import warnings
import zlib
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.csv_header import MAX_LINE_BYTES, explain_csv_error, parse_header, quote_name, read_header
from hubodo.log.input_limits import MemoryBudget, file_budget, max_expanded_bytes, open_regular
from hubodo.log.timebase import MAX_EXACT_S, format_decimal_seconds, parse_decimal_seconds
from hubodo.recording import Table

UNREADABLE, WRONG_COLUMN_COUNT, NOT_A_NUMBER, NOT_FINITE, NOT_INCREASING, TIME_OUT_OF_RANGE = (
    "not CSV",
    "wrong number of columns",
    "not a number",
    "NaN or infinity",
    "time does not increase",
    "time beyond 68 years",
)
"""Faults for which `repair` drops a row."""

MAX_TIME_S = 2.0**31
"""s; larger times do not fit a ROS time stamp and are probably in milliseconds or nanoseconds."""

_MIN_EXPANDED_BYTES = 8 << 20  # bytes to which a small gzipped file may expand
TABLE_COPIES = 3  # copies of the numbers in memory: as read, as one array, as columns
_MAX_SHOWN_CHARS = 80  # characters of a cell or a header in an error
_CSV_BLOCK_BYTES = 1 << 22
_NUMBER_CHARACTERS = b"0123456789+-.eE,\n"
_COMMA, _NEWLINE = 44, 10


@dataclass(frozen=True)
class ParsedFile:
    """The table of a file, and the number of rows dropped from it by fault (only with `repair`)."""

    table: Table
    dropped: Mapping[str, int]


def read_table(path: Path, required: Sequence[str], *, repair: bool = False) -> ParsedFile:
    """Read one CSV file, gzipped if its name ends in `.gz`.

    Raises InputError with file, row and remedy if the file is unreadable, has no header, or lacks or repeats
    a column; and, unless `repair` drops such rows, for a wrong number of columns, a cell that is not a finite
    number, and time that does not increase.
    """
    try:
        with open_regular(path) as file, _open_expanded(path, file) as stream:
            header, line = read_header(path, stream)
            names = parse_header(path, header, line, required)
            reader = _TableReader(path, names, repair)
            budget, room = MemoryBudget(path), file_budget(path, _max_text_bytes(path))
            for block in _iterate_blocks(path, stream):
                room.claim(len(block), "its text")
                budget.claim(TABLE_COPIES * 8 * len(names) * block.count(b"\n"), "the table")
                reader.feed(block, line + 1)
                line += block.count(b"\n")
            return reader.result()
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"{path}: cannot be read ({reason}); check the file and its rights") from error


def write_table(path: Path, table: Table) -> None:
    """Write a table, each number in the shortest decimal form that reads back to the same float64."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(",".join(quote_name(name) for name in table) + "\n")
        stacked = [table[name] for name in table]
        for first in range(0, len(table), 1 << 16):
            rows = np.column_stack([column[first : first + (1 << 16)] for column in stacked]).tolist()
            cells = [list(map(repr, row)) for row in rows]
            if table.t_ns is not None:
                t_column = list(table).index("t")
                for row, t_ns in zip(cells, table.t_ns[first : first + (1 << 16)].tolist(), strict=True):
                    row[t_column] = format_decimal_seconds(t_ns)
            stream.write("".join([",".join(row) + "\n" for row in cells]))


class _TableReader:
    def __init__(self, path: Path, names: tuple[str, ...], repair: bool) -> None:
        self.path, self.names, self.repair = path, names, repair
        self.t_column = names.index("t")
        self.blocks: list[NDArray[np.float64]] = []
        self.exact_ns: list[NDArray[np.int64]] = []
        self.last_t = -math.inf
        self.dropped: Counter[str] = Counter()

    def feed(self, block: bytes, line: int) -> None:
        rows = _parse_clean_block(block, len(self.names))
        texts: list[bytes] | None = None
        if rows is None or not self._is_valid(rows):
            rows, texts = self._parse_lines(block, line)
        if not len(rows):
            return
        if abs(rows[0, self.t_column]) >= MAX_EXACT_S:
            if texts is None:
                texts = [row.split(b",")[self.t_column] for row in block.splitlines()]
            exact = parse_decimal_seconds(texts)
            self.exact_ns += [] if exact is None else [exact]
        self.last_t = float(rows[-1, self.t_column])
        self.blocks.append(rows)

    def _is_valid(self, rows: NDArray[np.float64]) -> bool:
        t = rows[:, self.t_column]
        return bool(
            np.isfinite(rows).all()
            and (np.abs(t) < MAX_TIME_S).all()
            and (self.repair or (len(t) == 0 or (t[0] > self.last_t and (np.diff(t) > 0).all())))
        )

    def _parse_lines(self, block: bytes, line: int) -> tuple[NDArray[np.float64], list[bytes]]:
        """Return the valid rows of a block, and the text of t in each."""
        valid_rows: list[list[float]] = []
        texts: list[bytes] = []
        last_t = self.last_t
        for offset, raw in enumerate(block.split(b"\n")):
            text = self._decode_line(raw, line + offset)
            if not text:
                continue
            row, kind, fault = self._parse_row(text)
            if not kind and not self.repair and row[self.t_column] <= last_t:
                kind, fault = NOT_INCREASING, f"t = {row[self.t_column]!r} comes after {last_t!r}"
            if not kind:
                last_t = row[self.t_column]
                valid_rows.append(row)
                texts.append(next(csv.reader([text]))[self.t_column].encode())
            elif self.repair:
                self.dropped[kind] += 1
            else:
                raise InputError(
                    f"{self.path}: row {line + offset}: {kind}: {fault}; correct it, or drop such rows with "
                    "hubodo import --repair"
                )
        return np.array(valid_rows, np.float64).reshape(-1, len(self.names)), texts

    def _decode_line(self, raw: bytes, line: int) -> str:
        try:
            return raw.decode("utf-8").partition("#")[0].strip()
        except UnicodeDecodeError:
            raise InputError(f"{self.path}: row {line}: is not UTF-8 text; convert the file") from None

    def _parse_row(self, text: str) -> tuple[list[float], str, str]:
        try:
            cells = next(csv.reader([text]))
        except csv.Error as error:
            return [], UNREADABLE, explain_csv_error(error)
        if len(cells) != len(self.names):
            return (
                [],
                WRONG_COLUMN_COUNT,
                f"{len(cells)} instead of {len(self.names)} ({', '.join(self.names)[:_MAX_SHOWN_CHARS]})",
            )
        row = []
        for name, cell in zip(self.names, cells, strict=True):
            try:
                # float() also accepts 1_000 and digits of other scripts, which no spreadsheet writes.
                value = float(cell) if cell.isascii() and "_" not in cell else None
            except ValueError:
                value = None
            if value is None:
                return [], NOT_A_NUMBER, f"{name} is {_quote_cell(cell)}"
            if not math.isfinite(value):
                return [], NOT_FINITE, f"{name} is {_quote_cell(cell)}"
            row.append(value)
        t = row[self.t_column]
        if abs(t) >= MAX_TIME_S:
            return [], TIME_OUT_OF_RANGE, f"t = {t!r}; t is in seconds, not in ms, µs or ns"
        return row, "", ""

    def result(self) -> ParsedFile:
        rows = np.concatenate(self.blocks) if self.blocks else np.empty((0, len(self.names)))
        exact = np.concatenate(self.exact_ns) if self.exact_ns else None
        if exact is not None and len(exact) != len(rows):
            exact = None
        t = rows[:, self.t_column]
        if len(t) > 1 and not bool((np.diff(t) > 0).all()):
            increasing = longest_increasing_rows(t)
            self.dropped[NOT_INCREASING] += len(t) - len(increasing)
            rows = rows[increasing]
            exact = None if exact is None else exact[increasing]
        columns = np.ascontiguousarray(rows.T)
        table = Table({name: columns[i] for i, name in enumerate(self.names)}, exact)
        return ParsedFile(table, dict(self.dropped))


def _parse_clean_block(block: bytes, count: int) -> NDArray[np.float64] | None:
    """Return the rows of a block that contains only complete rows of numbers; None for any other block."""
    block = block.replace(b"\r\n", b"\n")
    if block.translate(None, _NUMBER_CHARACTERS) or not block:
        return None
    text = np.frombuffer(block, np.uint8)
    separators = text[(text == _COMMA) | (text == _NEWLINE)]
    pattern = np.array([_COMMA] * (count - 1) + [_NEWLINE], np.uint8)
    if len(separators) % count or not bool((separators.reshape(-1, count) == pattern).all()):
        return None
    cells = block[:-1].replace(b"\n", b",")
    # numpy would read an empty last cell as a number.
    if not block.endswith(b"\n") or b",," in cells or cells[:1] == b"," or cells[-1:] == b",":
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            numbers: NDArray[np.float64] = np.fromstring(cells.decode(), np.float64, sep=",")
    except (ValueError, DeprecationWarning):
        return None
    return numbers.reshape(-1, count) if len(numbers) == len(separators) else None


def longest_increasing_rows(t: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the rows of a longest increasing subsequence of t, so that a wild time stamp costs one row."""
    tails: list[float] = []
    tail_rows: list[int] = []
    previous = np.full(len(t), -1)
    for row, value in enumerate(t.tolist()):
        position = bisect_left(tails, value)
        if position == len(tails):
            tails.append(value)
            tail_rows.append(row)
        elif tails[position] > value:
            tails[position], tail_rows[position] = value, row
        else:
            continue
        previous[row] = tail_rows[position - 1] if position else -1
    increasing, row = [], tail_rows[-1]
    while row >= 0:
        increasing.append(row)
        row = int(previous[row])
    return np.array(increasing[::-1], np.intp)


def _open_expanded(path: Path, file: io.FileIO) -> IO[bytes]:
    if path.suffix == ".gz":
        return gzip.GzipFile(fileobj=file)  # type: ignore[return-value]
    return io.BufferedReader(file)


def _max_text_bytes(path: Path) -> int:
    """Return the largest plausible size of the text in a file, bytes."""
    size = path.stat().st_size
    return max_expanded_bytes(size, _MIN_EXPANDED_BYTES) if path.suffix == ".gz" else size + 1


def _iterate_blocks(path: Path, stream: IO[bytes]) -> Iterator[bytes]:
    """Yield the rest of a file in blocks of complete lines."""
    partial_line = b""
    while data := stream.read(_CSV_BLOCK_BYTES):
        complete, newline, remainder = data.rpartition(b"\n")
        if newline:
            yield partial_line + complete + newline
            partial_line = remainder
        else:
            partial_line += data
        if len(partial_line) > MAX_LINE_BYTES:
            raise InputError(f"{path}: a row is longer than {MAX_LINE_BYTES} bytes; correct it")
    if partial_line:
        yield partial_line + b"\n"


def _quote_cell(cell: str) -> str:
    """Return a cell in quotes, truncated if long."""
    cell = cell.strip()
    return (
        repr(cell)
        if len(cell) <= _MAX_SHOWN_CHARS
        else f"{cell[:_MAX_SHOWN_CHARS]!r}... ({len(cell)} characters)"
    )
