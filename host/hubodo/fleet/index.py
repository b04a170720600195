"""The table as an index of logs: listed, searched and summed up, and none of them read."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date

import pandas as pd

from hubodo.errors import InputError
from hubodo.fleet.finished import mentioning
from hubodo.fleet.names import TABLE
from hubodo.fleet.place import opened

_VERB = "info"
_OF_LOG = ("duration", "gaps")


@dataclass(frozen=True)
class Wanted:
    """Which logs. first, last: days, UTC. text: in the path, or in anything that `info` said of the log."""

    vehicle: str | None = None
    first: date | None = None
    last: date | None = None
    text: str | None = None


def read_index(output: str, wanted: Wanted) -> pd.DataFrame:
    """A row a log, the newest first: log, vehicle, start, duration, gaps, nodes, size, status, error.

    Raises InputError where no `hubodo batch info` wrote a table.
    """
    fs, folder = opened(output)
    path = f"{folder}/{TABLE}"
    if not fs.exists(path):
        raise InputError(f"{output}: has no {TABLE}; hubodo batch info LOGS -o {output} writes it")
    table = pd.read_parquet(path, filesystem=fs, filters=[("verb", "=", _VERB)])
    logs = table.drop_duplicates("log").set_index("log")[["vehicle", "start", "size", "status", "error"]]
    whole = table[table.node == ""]
    for name in _OF_LOG:
        logs[name] = whole[whole.quantity == name].set_index("log").value
    nodes = table[table.node.fillna("") != ""].drop_duplicates(["log", "node"])
    logs["nodes"] = nodes.groupby("log").node.agg(" ".join)
    logs["nodes"] = logs.nodes.fillna("")
    found = logs.reset_index().sort_values(["start", "log"], ascending=False, na_position="last")
    return _chosen(found, wanted, output)


def months(logs: pd.DataFrame) -> Iterable[tuple[str, int, float, int]]:
    """Month, logs, hours, gaps; logs without a date at the end."""
    month = logs.start.dt.strftime("%Y-%m").fillna("no date")
    for name, group in logs.groupby(month):
        yield str(name), len(group), group.duration.sum() / 3600.0, int(group.gaps.sum())


def _chosen(logs: pd.DataFrame, wanted: Wanted, output: str) -> pd.DataFrame:
    if wanted.vehicle is not None:
        logs = logs[logs.vehicle == wanted.vehicle]
    if wanted.first is not None:
        logs = logs[logs.start.dt.date >= wanted.first]
    if wanted.last is not None:
        logs = logs[logs.start.dt.date <= wanted.last]
    if wanted.text is not None:
        named = logs.log.str.contains(wanted.text, case=False, regex=False)
        logs = logs[named | logs.log.isin(mentioning(output, _VERB, wanted.text))]
    return logs
