"""List, search and summarise logs from the batch table, without reading the logs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date

import pandas as pd

from hubodo.errors import InputError
from hubodo.fleet.file_names import TABLE_FILE
from hubodo.fleet.result_store import find_logs_mentioning
from hubodo.fleet.storage import open_file_system

_INDEXED_VERB = "info"
_LOG_QUANTITIES = ("duration", "gaps")


@dataclass(frozen=True)
class IndexQuery:
    """A filter of logs. first, last: days, UTC. text: part of the path or of the result of `info`."""

    vehicle: str | None = None
    first: date | None = None
    last: date | None = None
    text: str | None = None


def read_index(output: str, query: IndexQuery) -> pd.DataFrame:
    """Return one row per log, newest first: log, vehicle, start, duration, gaps, nodes, size, status, error.

    Raises InputError if `hubodo batch info` has not written a table there.
    """
    fs, folder = open_file_system(output)
    path = f"{folder}/{TABLE_FILE}"
    if not fs.exists(path):
        raise InputError(f"{output}: has no {TABLE_FILE}; hubodo batch info LOGS -o {output} writes it")
    table = pd.read_parquet(path, filesystem=fs, filters=[("verb", "=", _INDEXED_VERB)])
    logs = table.drop_duplicates("log").set_index("log")[["vehicle", "start", "size", "status", "error"]]
    log_rows = table[table.node == ""]
    for name in _LOG_QUANTITIES:
        logs[name] = log_rows[log_rows.quantity == name].set_index("log").value
    nodes = table[table.node.fillna("") != ""].drop_duplicates(["log", "node"])
    logs["nodes"] = nodes.groupby("log").node.agg(" ".join)
    logs["nodes"] = logs.nodes.fillna("")
    index = logs.reset_index().sort_values(["start", "log"], ascending=False, na_position="last")
    return _filter_logs(index, query, output)


def summarise_months(logs: pd.DataFrame) -> Iterable[tuple[str, int, float, int]]:
    """Yield month, number of logs, hours and gaps; logs without a date last."""
    month = logs.start.dt.strftime("%Y-%m").fillna("no date")
    for name, group in logs.groupby(month):
        yield str(name), len(group), group.duration.sum() / 3600.0, int(group.gaps.sum())


def _filter_logs(logs: pd.DataFrame, query: IndexQuery, output: str) -> pd.DataFrame:
    if query.vehicle is not None:
        logs = logs[logs.vehicle == query.vehicle]
    if query.first is not None:
        logs = logs[logs.start.dt.date >= query.first]
    if query.last is not None:
        logs = logs[logs.start.dt.date <= query.last]
    if query.text is not None:
        is_in_path = logs.log.str.contains(query.text, case=False, regex=False)
        logs = logs[is_in_path | logs.log.isin(find_logs_mentioning(output, _INDEXED_VERB, query.text))]
    return logs
