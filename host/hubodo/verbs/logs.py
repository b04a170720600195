"""`hubodo logs`: list, search and summarise logs from their index."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from hubodo.extras import require_extra

if TYPE_CHECKING:
    import pandas as pd

EXAMPLE = (
    "hubodo batch info drives/ -o index/\n"
    "  hubodo logs index/ --vehicle van-7 --from 2026-06-01 --search reset"
)

_MAX_LISTED_LOGS = 40


@dataclass(frozen=True)
class LogListing:
    """The logs that match a query.

    Attributes
    ----------
    index
        Folder or URL of the index.
    logs
        One row for each log, newest first.
    months
        Month, number of logs, hours and number of gaps.
    """

    index: str
    logs: pd.DataFrame
    months: Sequence[tuple[str, int, float, int]]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result; duration in s, start in ISO 8601, null where unknown."""
        return {
            "index": self.index,
            "logs": len(self.logs),
            "hours": float(self.logs.duration.sum()) / 3600.0,
            "size_bytes": int(self.logs["size"].sum()),
            "gaps": int(self.logs.gaps.sum()),
            "vehicles": sorted(set(self.logs.vehicle)),
            "months": [
                {"month": month, "logs": logs, "hours": hours, "gaps": gaps}
                for month, logs, hours, gaps in self.months
            ],
            "list": [
                {
                    "log": row.log,
                    "vehicle": row.vehicle,
                    "start": _iso_text(row.start) or None,
                    "duration": row.duration if row.duration >= 0.0 else None,
                    "gaps": int(row.gaps) if row.gaps >= 0 else None,
                    "nodes": row.nodes.split(),
                    "size": int(row.size),
                    "error": row.error if row.status != "done" else None,
                }
                for row in self.logs.itertuples(index=False)
            ],
        }

    def render(self, console: Console) -> None:
        """Print totals, one row for each month, then the newest logs."""
        logs = self.logs
        hours, size = logs.duration.sum() / 3600.0, logs["size"].sum() / 1e9
        console.print(
            f"{len(logs)} logs of {logs.vehicle.nunique()} vehicles, {hours:.1f} h, {size:.2f} GB, "
            f"{int(logs.gaps.sum())} gaps",
            highlight=False,
        )
        by_month = Table("month", "logs", "hours", "gaps", box=None)
        for month, count, duration, gaps in self.months:
            by_month.add_row(month, str(count), f"{duration:.1f}", str(gaps))
        console.print(by_month)
        table = Table("start", "vehicle", "s", "gaps", "nodes", "log", box=None)
        for row in logs.head(_MAX_LISTED_LOGS).itertuples(index=False):
            is_done = row.status == "done"
            numbers = (f"{row.duration:.0f}", f"{row.gaps:.0f}") if is_done else ("", "")
            table.add_row(_iso_text(row.start), row.vehicle, *numbers, row.nodes, row.log)
        console.print(table)
        if len(logs) > _MAX_LISTED_LOGS:
            console.print(
                f"and {len(logs) - _MAX_LISTED_LOGS} earlier ones (--json shows all)", highlight=False
            )


def _iso_text(start: pd.Timestamp) -> str:
    return "" if start != start else start.isoformat(timespec="seconds")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo logs`."""
    parser.add_argument("index", metavar="INDEX", help="folder or URL that `hubodo batch info ... -o` wrote")
    parser.add_argument("--vehicle", metavar="NAME", help="only logs of this vehicle")
    for option, dest, words in (("--from", "first", "not before"), ("--to", "last", "not after")):
        parser.add_argument(
            option,
            dest=dest,
            type=_parse_day,
            metavar="DATE",
            help=f"{words} this day (UTC), such as 2026-06-30",
        )
    parser.add_argument(
        "--search",
        metavar="TEXT",
        help="text in the path, or in the nodes, events, gap causes or metadata of the log",
    )


def run(args: argparse.Namespace) -> LogListing:
    """Query the index.

    Returns
    -------
    LogListing
        The matching logs, newest first, and their totals by month.

    Raises
    ------
    InputError
        If there is no index at the given place.
    """
    require_extra("batch", "hubodo logs", ("fsspec", "pandas", "pyarrow"))
    from hubodo.fleet.index import IndexQuery, read_index, summarise_months

    logs = read_index(args.index, IndexQuery(args.vehicle, args.first, args.last, args.search))
    return LogListing(args.index, logs, tuple(summarise_months(logs)))


def _parse_day(text: str) -> date:
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text[:40]}: write a day such as 2026-06-30") from None
