"""`hubodo import`: a CSV folder into a log."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.log.container import temporary_beside
from hubodo.log.convert import write_recording
from hubodo.log.csv_folder import read_folder
from hubodo.progress import progress_line

HELP = "turn a folder of CSV files into a log"
EXAMPLE = "hubodo import drive/ -o drive.mcap"


@dataclass(frozen=True)
class Imported:
    """Rows taken from each file, and the account of rows that `--repair` dropped."""

    log: str
    rows: dict[str, int]
    messages: int
    dropped: dict[str, dict[str, int]]

    def as_json(self) -> dict[str, Any]:
        """As `--json` prints it."""
        return {"log": self.log, "rows": self.rows, "messages": self.messages, "dropped": self.dropped}

    def render(self, console: Console) -> None:
        """One line per file."""
        for name, count in self.rows.items():
            console.print(f"{name}: {count} rows", highlight=False, markup=False)
        for name, kinds in self.dropped.items():
            account = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
            console.print(f"{name}: dropped {account}", highlight=False, markup=False)
        console.print(f"wrote {self.log}: {self.messages} messages", highlight=False, markup=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo import`."""
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder of CSV files (may be gzipped)")
    parser.add_argument(
        "-o", "--output", metavar="FILE.mcap", type=Path, required=True, help="the log to write"
    )
    parser.add_argument(
        "--repair", action="store_true", help="drop rows that would be refused, and keep account of them"
    )


def run(args: argparse.Namespace) -> Imported:
    """Read the folder, write the log."""
    temporary_beside(args.output)
    with progress_line() as show:
        recording = read_folder(args.folder, repair=args.repair, progress=show)
        messages = write_recording(recording, args.output, progress=show)
    return Imported(
        log=str(args.output),
        rows={name: len(table) for name, table in recording.files().items()},
        messages=messages,
        dropped={event.source: dict(event.data["dropped"]) for event in recording.events},
    )
