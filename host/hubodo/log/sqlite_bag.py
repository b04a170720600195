"""Read the SQLite file of a rosbag2 without trusting it: stored tables, exact types, bounded work."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.input_limits import check_claim, check_regular, file_budget, limit_bytes

READ_ERRORS = (sqlite3.Error, ValueError)
"""Errors raised by a damaged database; ValueError for an error message that is not UTF-8."""
_REQUIRED_COLUMNS = {
    "topics": ("id", "name", "type", "serialization_format"),
    "messages": ("topic_id", "timestamp", "data"),
}
"""The tables of a rosbag2 and the columns that are read."""
_USABLE_ROW_SQL = "typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
_MAX_TOPICS = 65_535  # channel ids of MCAP, which a bag's messages become, are 16 bits wide
# A message row takes at least a dozen bytes of the file and some sixty steps of SQLite's virtual machine to
# count, sort and return, 5 steps a byte. Ten times that ends a query which a manipulated b-tree never ends.
_STEPS_PER_BYTE, _MIN_STEPS, _STEPS_BETWEEN_CHECKS = 50, 10_000_000, 100_000
_SMALLEST_LENGTH_LIMIT, _LARGEST_LENGTH_LIMIT = 1 << 20, (1 << 31) - 1  # bytes; the latter is SQLite's own


@dataclass(frozen=True)
class DatabaseFacts:
    """The contents of a database.

    Attributes
    ----------
    topics : (id, name, type, serialization format) each.
    n_messages : usable message rows.
    n_unusable : rows of topics and messages whose columns do not have the types that rosbag2 writes.
    is_sortable : True if messages can be sorted by time, which requires lengths that match the file size.
    """

    topics: tuple[tuple[int, str, str, str], ...]
    n_messages: int
    n_unusable: int
    is_sortable: bool


def read_database_facts(file: Path) -> DatabaseFacts:
    """Read topics and count messages.

    Raises one of READ_ERRORS if the file is not a database of rosbag2, InputError if it claims more data than
    the file can contain or if its tables are views, virtual or generated.
    """
    with _connect(file) as base:
        _check_tables(base, file)
        columns = ", ".join(_REQUIRED_COLUMNS["topics"])
        rows = base.execute(f"SELECT {columns} FROM topics").fetchmany(_MAX_TOPICS + 1)
        if len(rows) > _MAX_TOPICS:
            raise InputError(f"{file}: claims more than {_MAX_TOPICS} topics; record it again")
        topics = tuple(row for row in rows if _is_topic(row))
        try:
            n_usable, n_bytes, largest = base.execute(
                f"SELECT COUNT(*), SUM(length(data)), MAX(length(data)) FROM messages WHERE {_USABLE_ROW_SQL}"
            ).fetchone()
            n_rows = base.execute("SELECT COUNT(*) FROM messages").fetchone()[0]
            sortable = True
        except READ_ERRORS:  # a damaged page; the rows before it can still be read
            n_rows = n_usable = base.execute("SELECT COUNT(*) FROM messages").fetchone()[0]
            n_bytes, largest, sortable = 0, 0, False
        file_budget(file, _stored_bytes(file)).claim(n_bytes or 0, "the sum of its messages")
        check_claim(largest or 0, file, "its largest message")
        unusable = len(rows) - len(topics) + n_rows - n_usable
        return DatabaseFacts(topics, n_usable, unusable, sortable)


def iterate_messages(file: Path, facts: DatabaseFacts) -> Iterator[tuple[int, int, bytes]]:
    """Yield (topic id, time in ns, message) of all usable rows, by time if the database is sortable.

    Raises one of READ_ERRORS if the file is damaged, InputError if messages overlap in it.
    """
    order = "ORDER BY timestamp" if facts.is_sortable else ""
    budget = file_budget(file, _stored_bytes(file))
    with _connect(file) as base:
        _check_tables(base, file)
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE {_USABLE_ROW_SQL} {order}"
        for topic_id, t_ns, payload in base.execute(query):
            budget.claim(len(payload), "the sum of its messages")
            if t_ns >= 0:
                yield topic_id, t_ns, payload


@contextmanager
def _connect(file: Path) -> Iterator[sqlite3.Connection]:
    """Open a database read-only, with limits on the length of values and on the work of a query."""
    # A killed recorder leaves messages in a journal file; without one the database is immutable.
    journal = _sibling(file, "-wal")
    for path in (file, journal, _sibling(file, "-shm")):
        check_regular(path)
    mode = "mode=ro" if journal.exists() else "mode=ro&immutable=1"
    base = sqlite3.connect(f"{file.absolute().as_uri()}?{mode}", uri=True)
    try:
        base.text_factory = lambda text: text.decode("utf-8", "replace")
        length = min(max(limit_bytes(), _SMALLEST_LENGTH_LIMIT), _LARGEST_LENGTH_LIMIT)
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, length)
        base.execute("PRAGMA trusted_schema = OFF")
        checks_left = (_MIN_STEPS + _STEPS_PER_BYTE * _stored_bytes(file)) // _STEPS_BETWEEN_CHECKS

        def is_out_of_steps() -> bool:
            nonlocal checks_left
            checks_left -= 1
            return checks_left < 0

        base.set_progress_handler(is_out_of_steps, _STEPS_BETWEEN_CHECKS)
        yield base
    finally:
        base.close()


def _check_tables(base: sqlite3.Connection, file: Path) -> None:
    """Raise InputError unless topics and messages are stored tables with stored columns."""
    for table, needed in _REQUIRED_COLUMNS.items():
        # Views and virtual tables have no root page.
        entries = base.execute(
            "SELECT type = 'table' AND rootpage > 0 FROM sqlite_master WHERE lower(name) = ?", (table,)
        ).fetchall()
        if not entries:
            raise InputError(f"{file}: cannot be read as a rosbag (no table {table}); give a file of rosbag2")
        stored = {row[1]: row[6] == 0 for row in base.execute(f"PRAGMA table_xinfo({table})")}
        if entries != [(1,)] or not all(stored.values()):
            raise InputError(
                f"{file}: {table} is a view or is computed, not a stored table; record or convert it again"
            )
        if missing := [column for column in needed if column not in stored]:
            raise InputError(f"{file}: table {table} has no column {', '.join(missing)}; convert it again")


def _is_topic(row: tuple[object, ...]) -> bool:
    return type(row[0]) is int and all(isinstance(value, str) for value in row[1:])


def _stored_bytes(file: Path) -> int:
    """Return the bytes of a database and its journal."""
    return sum(path.stat().st_size for path in (file, _sibling(file, "-wal")) if path.exists())


def _sibling(file: Path, suffix: str) -> Path:
    return file.with_name(file.name + suffix)
