"""A batch from its logs to its table: what is known is not done again, what is finished is kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import pandas as pd
import pyarrow as pa

from hubodo.fleet.engine import each
from hubodo.fleet.finished import Finished
from hubodo.fleet.listing import LogPlace
from hubodo.fleet.names import PAGE
from hubodo.fleet.page import fleet_page
from hubodo.fleet.place import opened, reached, write_whole
from hubodo.fleet.table import write_table
from hubodo.fleet.task import KNOWN, Analysis, examine

if TYPE_CHECKING:
    from distributed import Client

_KEEP_S, _KEEP_ROWS = 10.0, 500
"""So long, or for so many logs, at the most a result is in memory alone."""
Progress = Callable[[str, float], None]


@dataclass
class _Kept:
    """Rows on their way to the disk."""

    finished: Finished
    new: list[dict[str, Any]] = field(default_factory=list)
    again: list[dict[str, Any]] = field(default_factory=list)
    since: float = field(default_factory=time.monotonic)

    def take(self, row: dict[str, Any]) -> None:
        (self.again if row["status"] == KNOWN else self.new).append(row)
        if len(self.new) >= _KEEP_ROWS or time.monotonic() - self.since > _KEEP_S:
            self.write()

    def write(self) -> None:
        self.finished.add(self.new)
        self.finished.add_again(self.again)
        self.new, self.again, self.since = [], [], time.monotonic()


@dataclass(frozen=True)
class Batch:
    """rows: of `finished.SCHEMA`, one a log. table: all of `OUT/table.parquet`. fresh: logs done now."""

    rows: pa.Table
    table: pd.DataFrame
    fresh: int


def run_batch(
    connect: Callable[[], Any], places: Sequence[LogPlace], analysis: Analysis, output: str, show: Progress
) -> Batch:
    """Examines each log that has no result yet; on KeyboardInterrupt the table has what is finished.

    connect: makes the context of a Dask client; not asked for where nothing is to be done.
    """
    finished = Finished(output, analysis)
    with reached(output):
        there = set(finished.rows(places)["log"].to_pylist())
    fresh = [place for place in places if place.url not in there]
    try:
        if fresh:
            show(f"starting, {len(fresh)} of {len(places)} logs to do", 0.0)
            with connect() as client:
                _examine_all(client, fresh, analysis, finished, output, show)
    finally:
        rows = pa.concat_tables([finished.rows(places), finished.failures(places)])
        table = write_table(output, analysis.verb, rows)
        show("drawing the page", 1.0)
        fs, folder = opened(output)
        write_whole(fs, f"{folder}/{PAGE}", fleet_page(table).encode())
    return Batch(rows, table, len(fresh))


def _examine_all(
    client: Client,
    places: Sequence[LogPlace],
    analysis: Analysis,
    finished: Finished,
    output: str,
    show: Progress,
) -> None:
    kept = _Kept(finished)
    work = partial(examine, analysis=analysis, known=finished.keys(), output=output)
    try:
        for number, (place, row) in enumerate(each(client, work, places), 1):
            about = {
                "verb": analysis.verb,
                "analysis": analysis.digest,
                "log": place.url,
                "stamp": place.stamp,
            }
            kept.take(
                {"size": place.size, "vehicle": place.folder, "version": analysis.version} | about | row
            )
            show(f"{number} of {len(places)} logs", number / len(places))
    finally:
        kept.write()
