"""What earlier runs finished, one row a log, in Parquet files that are only added: nothing is done twice."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from hubodo.fleet.listing import LogPlace
from hubodo.fleet.place import opened, write_whole
from hubodo.fleet.task import FAILED, Analysis

MEASURED = pa.struct(
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
        ("quantities", pa.list_(MEASURED)),
        ("result", pa.string()),
    ]
)
"""result: what the verb prints with --json. files: folder of what it wrote. cpu, wall: s."""
_SMALL = [name for name in SCHEMA.names if name != "result"]


class Finished:
    """Rows of one analysis under `OUT/finished`; output: a folder or its URL."""

    def __init__(self, output: str, analysis: Analysis) -> None:
        self._fs, path = opened(output)
        self._folder = f"{path}/finished"
        self._analysis = analysis

    def add(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Writes rows of `SCHEMA`; a file is there whole or not at all."""
        if not rows:
            return
        sink = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist(list(rows), SCHEMA), sink, compression="zstd")
        name = f"{self._folder}/{uuid.uuid4().hex}.parquet"
        write_whole(self._fs, name, sink.getvalue().to_pybytes())

    def add_again(self, seen: Sequence[Mapping[str, Any]]) -> None:
        """Rows of results that are there, under another log's name: its key, log, stamp, vehicle, start."""
        if not seen:
            return
        wanted = pc.field("key").isin([row["key"] for row in seen])
        there = {row["key"]: row for row in self._read(SCHEMA.names, wanted).to_pylist()}
        self.add([{**there[row["key"]], **_own(row), "cpu": row["cpu"]} for row in seen])

    def keys(self) -> frozenset[str]:
        """Of the results that are there."""
        return frozenset(self._read(["key"], pc.field("status") != FAILED)["key"].to_pylist())

    def rows(self, places: Sequence[LogPlace]) -> pa.Table:
        """The row of each of these logs, as it is now, that has one, without `result`; failures left out."""
        there = self._read(_SMALL, pc.field("status") != FAILED)
        return _newest(_of(there, places))

    def failures(self, places: Sequence[LogPlace]) -> pa.Table:
        """The newest row of each of these logs that ended in a failure and has no other row."""
        sound = set(self.rows(places)["log"].to_pylist())
        left = [place for place in places if place.url not in sound]
        return _newest(_of(self._read(_SMALL, pc.field("status") == FAILED), left))

    def _read(self, columns: list[str], where: Any) -> pa.Table:
        mine = pc.field("analysis") == self._analysis.digest
        return _read(self._fs, self._folder, columns, where & mine)


def mentioning(output: str, verb: str, text: str) -> set[str]:
    """Logs with a result of a verb in which a text stands, in small or capital letters."""
    fs, path = opened(output)
    said = pc.match_substring(pc.field("result"), text, ignore_case=True)
    found = _read(fs, f"{path}/finished", ["log"], (pc.field("verb") == verb) & said)
    return set(found["log"].to_pylist())


def _read(fs: Any, folder: str, columns: list[str], where: Any) -> pa.Table:
    files = sorted(fs.glob(f"{folder}/*.parquet"))
    if not files:
        return SCHEMA.empty_table().select(columns)
    return ds.dataset(files, schema=SCHEMA, filesystem=fs, format="parquet").to_table(columns, filter=where)


def _own(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: row[name] for name in ("log", "stamp", "size", "vehicle", "start")}


def _of(there: pa.Table, places: Sequence[LogPlace]) -> pa.Table:
    """The rows of logs that are as they were."""
    now = {(place.url, place.stamp) for place in places}
    pairs = zip(there["log"].to_pylist(), there["stamp"].to_pylist(), strict=True)
    return there.filter(pa.array([pair in now for pair in pairs], pa.bool_()))


def _newest(rows: pa.Table) -> pa.Table:
    """The last row of each log."""
    last = {log: number for number, log in enumerate(rows["log"].to_pylist())}
    return rows.take(pa.array(sorted(last.values()), pa.int64()))
