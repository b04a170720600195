"""Run a batch from its logs to its table, skipping finished logs and saving results as they arrive."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import pandas as pd
import pyarrow as pa

from hubodo.fleet.engine import examine_each
from hubodo.fleet.file_names import PAGE_FILE
from hubodo.fleet.listing import LogLocation
from hubodo.fleet.page import build_fleet_page
from hubodo.fleet.result_store import ResultStore
from hubodo.fleet.storage import open_file_system, report_store_errors, write_atomically
from hubodo.fleet.table import update_table
from hubodo.fleet.task import KNOWN, Analysis, examine_log
from hubodo.progress_callback import Progress

if TYPE_CHECKING:
    from distributed import Client

_FLUSH_PERIOD_S, _MAX_BUFFERED_ROWS = 10.0, 500
"""Maximum age (s) and number of results in memory before they are stored."""


@dataclass
class _RowBuffer:
    """A buffer of rows that are not stored yet."""

    store: ResultStore
    new: list[dict[str, Any]] = field(default_factory=list)
    known: list[dict[str, Any]] = field(default_factory=list)
    last_flush: float = field(default_factory=time.monotonic)

    def add(self, row: dict[str, Any]) -> None:
        (self.known if row["status"] == KNOWN else self.new).append(row)
        if len(self.new) >= _MAX_BUFFERED_ROWS or time.monotonic() - self.last_flush > _FLUSH_PERIOD_S:
            self.flush()

    def flush(self) -> None:
        self.store.add(self.new)
        self.store.add_copies(self.known)
        self.new, self.known, self.last_flush = [], [], time.monotonic()


@dataclass(frozen=True)
class BatchOutcome:
    """The result of a batch.

    Attributes
    ----------
    rows : one row of `result_store.SCHEMA` per log.
    table : the whole `OUT/table.parquet`.
    n_examined : number of logs examined in this run.
    """

    rows: pa.Table
    table: pd.DataFrame
    n_examined: int


def run_batch(
    connect: Callable[[Sequence[LogLocation]], Any],
    locations: Sequence[LogLocation],
    analysis: Analysis,
    output: str,
    report_progress: Progress,
) -> BatchOutcome:
    """Examine each log without a result; on KeyboardInterrupt the table contains the finished logs.

    connect: returns a context manager of a Dask client for the unfinished logs, or of None to examine them in
    this process; not called if every log is finished.
    """
    store = ResultStore(output, analysis)
    with report_store_errors(output):
        finished_logs = set(store.rows(locations)["log"].to_pylist())
    unfinished = [place for place in locations if place.url not in finished_logs]
    try:
        if unfinished:
            report_progress(f"starting, {len(unfinished)} of {len(locations)} logs to do", 0.0)
            with connect(unfinished) as client:
                _examine_all(client, unfinished, analysis, store, output, report_progress)
    finally:
        rows = pa.concat_tables([store.rows(locations), store.failures(locations)])
        table = update_table(output, analysis.verb, rows)
        report_progress("drawing the page", 1.0)
        fs, folder = open_file_system(output)
        write_atomically(fs, f"{folder}/{PAGE_FILE}", build_fleet_page(table).encode())
    return BatchOutcome(rows, table, len(unfinished))


def _examine_all(
    client: Client | None,
    locations: Sequence[LogLocation],
    analysis: Analysis,
    store: ResultStore,
    output: str,
    report_progress: Progress,
) -> None:
    buffer = _RowBuffer(store)
    examine = partial(examine_log, analysis=analysis, known_keys=store.keys(), output=output)
    try:
        for number, (place, row) in enumerate(examine_each(client, examine, locations), 1):
            identity = {
                "verb": analysis.verb,
                "analysis": analysis.digest,
                "log": place.url,
                "stamp": place.stamp,
            }
            buffer.add(
                {"size": place.size, "vehicle": place.folder, "version": analysis.version} | identity | row
            )
            report_progress(f"{number} of {len(locations)} logs", number / len(locations))
    finally:
        buffer.flush()
