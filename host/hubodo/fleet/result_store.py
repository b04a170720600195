"""Store results of finished logs, one row per log, in append-only Parquet files."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from hubodo.fleet.listing import LogLocation
from hubodo.fleet.storage import open_file_system, write_atomically
from hubodo.fleet.task import FAILED, Analysis

QUANTITY_STRUCT = pa.struct(
    [
        ("node", pa.string()),
        ("quantity", pa.string()),
        ("value", pa.float64()),
        ("sigma", pa.float64()),
        ("unit", pa.string()),
        ("p_value", pa.float64()),
    ]
)
SCHEMA = pa.schema(
    [
        ("verb", pa.string()),
        ("analysis", pa.string()),
        ("version", pa.string()),
        ("key", pa.string()),
        ("log", pa.string()),
        ("stamp", pa.string()),
        ("sha256", pa.string()),
        ("size", pa.int64()),
        ("vehicle", pa.string()),
        ("start", pa.timestamp("us", tz="UTC")),
        ("status", pa.string()),
        ("error", pa.string()),
        ("files", pa.string()),
        ("cpu", pa.float64()),
        ("wall", pa.float64()),
        ("quantities", pa.list_(QUANTITY_STRUCT)),
        ("result", pa.string()),
    ]
)
"""Schema of a row. result: output of the verb with --json; files: folder of its output; cpu, wall: s."""
_COLUMNS_WITHOUT_RESULT = [name for name in SCHEMA.names if name != "result"]


class ResultStore:
    """The stored rows of one analysis under `OUT/finished`. output: a folder or its URL."""

    def __init__(self, output: str, analysis: Analysis) -> None:
        self._fs, path = open_file_system(output)
        self._folder = f"{path}/finished"
        self._analysis = analysis

    def add(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write rows of `SCHEMA` as one new file, atomically."""
        if not rows:
            return
        sink = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist(list(rows), SCHEMA), sink, compression="zstd")
        name = f"{self._folder}/{uuid.uuid4().hex}.parquet"
        write_atomically(self._fs, name, sink.getvalue().to_pybytes())

    def add_copies(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Copy stored results to logs with identical content. rows: key and log columns of the new rows."""
        if not rows:
            return
        wanted = pc.field("key").isin([row["key"] for row in rows])
        stored = {row["key"]: row for row in self._read(SCHEMA.names, wanted).to_pylist()}
        self.add([{**stored[row["key"]], **_log_columns(row), "cpu": row["cpu"]} for row in rows])

    def keys(self) -> frozenset[str]:
        """Return the keys of all stored results."""
        return frozenset(self._read(["key"], pc.field("status") != FAILED)["key"].to_pylist())

    def rows(self, locations: Sequence[LogLocation]) -> pa.Table:
        """Return the rows, without `result`, of logs that have a result and are unchanged since."""
        stored = self._read(_COLUMNS_WITHOUT_RESULT, pc.field("status") != FAILED)
        return _last_row_of_each_log(_rows_of_unchanged(stored, locations))

    def failures(self, locations: Sequence[LogLocation]) -> pa.Table:
        """Return the newest row of each of these logs that failed and has no result."""
        succeeded = set(self.rows(locations)["log"].to_pylist())
        remaining = [place for place in locations if place.url not in succeeded]
        return _last_row_of_each_log(
            _rows_of_unchanged(self._read(_COLUMNS_WITHOUT_RESULT, pc.field("status") == FAILED), remaining)
        )

    def _read(self, columns: list[str], where: Any) -> pa.Table:
        mine = pc.field("analysis") == self._analysis.digest
        return _read_rows(self._fs, self._folder, columns, where & mine)


def find_logs_mentioning(output: str, verb: str, text: str) -> set[str]:
    """Return the logs whose result of a verb contains a text, ignoring case."""
    fs, path = open_file_system(output)
    mentions = pc.match_substring(pc.field("result"), text, ignore_case=True)
    rows = _read_rows(fs, f"{path}/finished", ["log"], (pc.field("verb") == verb) & mentions)
    return set(rows["log"].to_pylist())


def _read_rows(fs: Any, folder: str, columns: list[str], condition: Any) -> pa.Table:
    files = sorted(fs.glob(f"{folder}/*.parquet"))
    if not files:
        return SCHEMA.empty_table().select(columns)
    return ds.dataset(files, schema=SCHEMA, filesystem=fs, format="parquet").to_table(
        columns, filter=condition
    )


def _log_columns(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: row[name] for name in ("log", "stamp", "size", "vehicle", "start")}


def _rows_of_unchanged(rows: pa.Table, locations: Sequence[LogLocation]) -> pa.Table:
    """Return the rows of logs that are unchanged (same URL and stamp)."""
    current = {(place.url, place.stamp) for place in locations}
    pairs = zip(rows["log"].to_pylist(), rows["stamp"].to_pylist(), strict=True)
    return rows.filter(pa.array([pair in current for pair in pairs], pa.bool_()))


def _last_row_of_each_log(rows: pa.Table) -> pa.Table:
    """Return the last row of each log."""
    last = {log: number for number, log in enumerate(rows["log"].to_pylist())}
    return rows.take(pa.array(sorted(last.values()), pa.int64()))
