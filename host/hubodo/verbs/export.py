"""`hubodo export`: a log into a CSV folder, or the same tables as Parquet."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.log.any_log import read_log
from hubodo.log.csv_folder import write_folder
from hubodo.progress import progress_line
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import LOG_HELP, add_log_options, add_vehicle_option, log_form

EXAMPLE = "hubodo export drive.mcap -o drive/"


@dataclass(frozen=True)
class Exported:
    """Files written and rows in each; warnings about damage in the log."""

    folder: str
    rows: dict[str, int]
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """As `--json` prints it."""
        return {"folder": self.folder, "rows": self.rows, "warnings": list(self.warnings)}

    def render(self, console: Console) -> None:
        """One line per file."""
        for line in self.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)
        for name, count in self.rows.items():
            console.print(
                f"{self.folder}/{name}: {count} rows", highlight=False, markup=False, soft_wrap=True
            )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo export`."""
    parser.add_argument("log", metavar="LOG", type=Path, help=LOG_HELP)
    add_log_options(parser)
    add_vehicle_option(parser)
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, required=True, help="the folder to make")
    parser.add_argument(
        "--format", choices=("csv", "parquet"), default="csv", help="parquet needs pyarrow (hubodo[parquet])"
    )


def run(args: argparse.Namespace) -> Exported:
    """Read the log, write the folder."""
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    with progress_line() as show:
        recording = read_log(args.log, form=log_form(args, vehicle), progress=show, keep_empty=True)
        names = write_folder(recording, args.output, form=args.format, progress=show)
    counts = [len(table) for table in recording.files().values()]
    return Exported(str(args.output), dict(zip(names, counts, strict=True)), recording.warnings)
