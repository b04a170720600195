"""One CSV file to columns and back: strict, fast, and every fault with its row.

Rows are named by their line in the file, counted from 1, so that an editor finds them. Whole blocks of clean
numbers are parsed at once; a block with anything else in it is read line by line, to name the fault.
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
from itertools import count
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.input_limits import MemoryBudget, file_budget, open_regular, room_of
from hubodo.log.timebase import MAX_EXACT_S, format_decimal_seconds, parse_decimal_seconds
from hubodo.recording import Table

UNREADABLE, MISSING, NOT_A_NUMBER, NOT_FINITE, NOT_INCREASING, BEYOND = (
    "not CSV",
    "wrong number of columns",
    "not a number",
    "NaN or infinity",
    "time does not increase",
    "time beyond 68 years",
)
"""Kinds of fault that `repair` drops rows for."""

T_LIMIT = 2.0**31
"""s; times beyond this fit no ROS time stamp, and are milliseconds or nanoseconds by mistake."""

LONGEST_LINE = 1 << 20
"""Bytes; nothing longer is a row of numbers."""
MOST_COLUMNS = 1000
_LONGEST_PREAMBLE = 10_000  # lines of comments above the header
_LEAST_TEXT = 8 << 20  # bytes that a small gzipped file may hold
_ROW_COPIES = 3  # of the numbers in memory: as blocks, as one array, as columns
_SHOWN = 80  # letters of a cell or a header in an error
_BLOCK = 1 << 22
_CLEAN = b"0123456789+-.eE,\n"
_COMMA, _NEWLINE = 44, 10


@dataclass(frozen=True)
class ParsedFile:
    """A file's table, and how many rows of each kind of fault were dropped from it (only with repair)."""

    table: Table
    dropped: Mapping[str, int]


def read_table(path: Path, required: Sequence[str], *, repair: bool = False) -> ParsedFile:
    """Read one CSV file, gzipped if its name ends in `.gz`.

    Raises InputError with file, row and remedy: unreadable, no header, missing or repeated column, and,
    unless `repair` drops such rows: wrong number of columns, no number, NaN, infinity, time not increasing.
    """
    try:
        with open_regular(path) as file, _expanded(path, file) as stream:
            header, line, blocks = _split(path, stream)
            names = _names(path, header, line, required)
            reader = _Reader(path, names, repair)
            budget, room = MemoryBudget(path), file_budget(path, _room(path))
            for block in blocks:
                room.claim(len(block), "its text")
                budget.claim(_ROW_COPIES * 8 * len(names) * block.count(b"\n"), "the table")
                reader.feed(block, line + 1)
                line += block.count(b"\n")
            return reader.result()
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise InputError(f"{path}: cannot be read ({reason}); check the file and its rights") from error


def write_table(path: Path, table: Table) -> None:
    """Write a table with the shortest decimal form of each number that reads back to the same float64."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(",".join(_quoted(name) for name in table) + "\n")
        stacked = [table[name] for name in table]
        for first in range(0, len(table), 1 << 16):
            rows = np.column_stack([column[first : first + (1 << 16)] for column in stacked]).tolist()
            cells = [list(map(repr, row)) for row in rows]
            if table.t_ns is not None:
                place = list(table).index("t")
                for row, t_ns in zip(cells, table.t_ns[first : first + (1 << 16)].tolist(), strict=True):
                    row[place] = format_decimal_seconds(t_ns)
            stream.write("".join([",".join(row) + "\n" for row in cells]))


class _Reader:
    def __init__(self, path: Path, names: tuple[str, ...], repair: bool) -> None:
        self.path, self.names, self.repair = path, names, repair
        self.t_column = names.index("t")
        self.blocks: list[NDArray[np.float64]] = []
        self.exact: list[NDArray[np.int64]] = []
        self.last_t = -math.inf
        self.dropped: Counter[str] = Counter()

    def feed(self, block: bytes, line: int) -> None:
        rows = _parse_clean(block, len(self.names))
        texts: list[bytes] | None = None
        if rows is None or not self._sound(rows):
            rows, texts = self._parse_lines(block, line)
        if not len(rows):
            return
        if abs(rows[0, self.t_column]) >= MAX_EXACT_S:
            if texts is None:
                texts = [row.split(b",")[self.t_column] for row in block.splitlines()]
            exact = parse_decimal_seconds(texts)
            self.exact += [] if exact is None else [exact]
        self.last_t = float(rows[-1, self.t_column])
        self.blocks.append(rows)

    def _sound(self, rows: NDArray[np.float64]) -> bool:
        t = rows[:, self.t_column]
        return bool(
            np.isfinite(rows).all()
            and (np.abs(t) < T_LIMIT).all()
            and (self.repair or (len(t) == 0 or (t[0] > self.last_t and (np.diff(t) > 0).all())))
        )

    def _parse_lines(self, block: bytes, line: int) -> tuple[NDArray[np.float64], list[bytes]]:
        """The rows of a block, and the text of t in each."""
        kept: list[list[float]] = []
        texts: list[bytes] = []
        last_t = self.last_t
        for offset, raw in enumerate(block.split(b"\n")):
            text = self._text(raw, line + offset)
            if not text:
                continue
            row, kind, fault = self._row(text)
            if not kind and not self.repair and row[self.t_column] <= last_t:
                kind, fault = NOT_INCREASING, f"t = {row[self.t_column]!r} comes after {last_t!r}"
            if not kind:
                last_t = row[self.t_column]
                kept.append(row)
                texts.append(next(csv.reader([text]))[self.t_column].encode())
            elif self.repair:
                self.dropped[kind] += 1
            else:
                raise InputError(
                    f"{self.path}: row {line + offset}: {kind}: {fault}; correct it, or drop such rows with "
                    "hubodo import --repair"
                )
        return np.array(kept, np.float64).reshape(-1, len(self.names)), texts

    def _text(self, raw: bytes, line: int) -> str:
        try:
            return raw.decode("utf-8").partition("#")[0].strip()
        except UnicodeDecodeError:
            raise InputError(f"{self.path}: row {line}: is not UTF-8 text; convert the file") from None

    def _row(self, text: str) -> tuple[list[float], str, str]:
        try:
            cells = next(csv.reader([text]))
        except csv.Error as error:
            return [], UNREADABLE, _csv_fault(error)
        if len(cells) != len(self.names):
            return (
                [],
                MISSING,
                f"{len(cells)} instead of {len(self.names)} ({', '.join(self.names)[:_SHOWN]})",
            )
        row = []
        for name, cell in zip(self.names, cells, strict=True):
            try:
                # float() also takes 1_000 and digits of other scripts: no spreadsheet writes those.
                value = float(cell) if cell.isascii() and "_" not in cell else None
            except ValueError:
                value = None
            if value is None:
                return [], NOT_A_NUMBER, f"{name} is {_shown(cell)}"
            if not math.isfinite(value):
                return [], NOT_FINITE, f"{name} is {_shown(cell)}"
            row.append(value)
        t = row[self.t_column]
        if abs(t) >= T_LIMIT:
            return [], BEYOND, f"t = {t!r}; t is in seconds, not in ms, µs or ns"
        return row, "", ""

    def result(self) -> ParsedFile:
        rows = np.concatenate(self.blocks) if self.blocks else np.empty((0, len(self.names)))
        exact = np.concatenate(self.exact) if self.exact else None
        if exact is not None and len(exact) != len(rows):
            exact = None
        t = rows[:, self.t_column]
        if len(t) > 1 and not bool((np.diff(t) > 0).all()):
            keep = longest_increasing(t)
            self.dropped[NOT_INCREASING] += len(t) - len(keep)
            rows = rows[keep]
            exact = None if exact is None else exact[keep]
        columns = np.ascontiguousarray(rows.T)
        table = Table({name: columns[i] for i, name in enumerate(self.names)}, exact)
        return ParsedFile(table, dict(self.dropped))


def _parse_clean(block: bytes, count: int) -> NDArray[np.float64] | None:
    """Rows of a block that holds nothing but numbers, all rows complete; None for any other block."""
    block = block.replace(b"\r\n", b"\n")
    if block.translate(None, _CLEAN) or not block:
        return None
    text = np.frombuffer(block, np.uint8)
    separators = text[(text == _COMMA) | (text == _NEWLINE)]
    pattern = np.array([_COMMA] * (count - 1) + [_NEWLINE], np.uint8)
    if len(separators) % count or not bool((separators.reshape(-1, count) == pattern).all()):
        return None
    cells = block[:-1].replace(b"\n", b",")
    # numpy would make a number out of an empty last cell.
    if not block.endswith(b"\n") or b",," in cells or cells[:1] == b"," or cells[-1:] == b",":
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            numbers: NDArray[np.float64] = np.fromstring(cells.decode(), np.float64, sep=",")
    except (ValueError, DeprecationWarning):
        return None
    return numbers.reshape(-1, count) if len(numbers) == len(separators) else None


def longest_increasing(t: NDArray[np.float64]) -> NDArray[np.intp]:
    """Rows of a longest strictly increasing sequence: a wild time stamp costs one row, not all after it."""
    tails: list[float] = []
    tail_rows: list[int] = []
    before = np.full(len(t), -1)
    for row, value in enumerate(t.tolist()):
        place = bisect_left(tails, value)
        if place == len(tails):
            tails.append(value)
            tail_rows.append(row)
        elif tails[place] > value:
            tails[place], tail_rows[place] = value, row
        else:
            continue
        before[row] = tail_rows[place - 1] if place else -1
    keep, row = [], tail_rows[-1]
    while row >= 0:
        keep.append(row)
        row = int(before[row])
    return np.array(keep[::-1], np.intp)


def _expanded(path: Path, file: io.FileIO) -> IO[bytes]:
    if path.suffix == ".gz":
        return gzip.GzipFile(fileobj=file)  # type: ignore[return-value]
    return io.BufferedReader(file)


def _room(path: Path) -> int:
    """Return the bytes of text that a file can hold."""
    size = path.stat().st_size
    return room_of(size, _LEAST_TEXT) if path.suffix == ".gz" else size + 1


def _split(path: Path, stream: IO[bytes]) -> tuple[str, int, Iterator[bytes]]:
    """The header, its line number, and the rest in blocks of whole lines."""
    for number in count(1):
        raw = stream.readline(LONGEST_LINE + 1)
        if not raw:
            break
        if len(raw) > LONGEST_LINE or number > _LONGEST_PREAMBLE:
            raise InputError(f"{path}: row {number}: no header of a table in CSV; give a file with one")
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8").strip()
        except UnicodeDecodeError:
            raise InputError(f"{path}: row {number}: is not UTF-8 text; convert the file") from None
        if text and not text.startswith("#"):
            return text, number, _blocks(path, stream)
    raise InputError(f"{path}: is empty; give it a header row and data, or remove it")


def _blocks(path: Path, stream: IO[bytes]) -> Iterator[bytes]:
    rest = b""
    while data := stream.read(_BLOCK):
        whole, newline, rest_of = data.rpartition(b"\n")
        if newline:
            yield rest + whole + newline
            rest = rest_of
        else:
            rest += data
        if len(rest) > LONGEST_LINE:
            raise InputError(f"{path}: a row is longer than {LONGEST_LINE} bytes; correct it")
    if rest:
        yield rest + b"\n"


def _names(path: Path, header: str, line: int, required: Sequence[str]) -> tuple[str, ...]:
    try:
        names = tuple(name.strip() for name in next(csv.reader([header])))
    except csv.Error as error:
        raise InputError(f"{path}: row {line}: {_csv_fault(error)}; save it again as CSV") from None
    if len(names) > MOST_COLUMNS:
        raise InputError(f"{path}: row {line}: {len(names)} columns, {MOST_COLUMNS} at most; split the file")
    missing = [name for name in required if name not in names]
    if missing:
        raise InputError(
            f"{path}: row {line}: no column {', '.join(missing)} in the header {header[:80]!r}; "
            f"the columns must include {','.join(required)}"
        )
    for name, times in Counter(names).items():
        if times > 1:
            raise InputError(f"{path}: row {line}: column {name!r} stands twice in the header; rename one")
    return names


def _shown(cell: str) -> str:
    """Return a cell in quotes, shortened where it is long."""
    cell = cell.strip()
    return repr(cell) if len(cell) <= _SHOWN else f"{cell[:_SHOWN]!r}... ({len(cell)} letters)"


def _csv_fault(error: csv.Error) -> str:
    text = str(error)
    if "new-line" in text:
        return "carriage returns without line feeds within it"
    return "a cell longer than any number" if "field larger" in text else text


def _quoted(name: str) -> str:
    if any(character in name for character in ',"#'):
        return '"' + name.replace('"', '""') + '"'
    return name
