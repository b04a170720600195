"""`hubodo import`: convert CSV files or a rosbag into a log, or decode the raw frames of a log again."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.atomic_files import require_free_path
from hubodo.errors import InputError
from hubodo.ingest.replay.redecode import RedecodedLog, redecode_log
from hubodo.log.any_log import find_mcap_file, is_hubodo_mcap, is_rosbag, read_log
from hubodo.log.csv_folder import read_folder
from hubodo.log.number_recording import convert_to_si
from hubodo.log.phone_folder import is_phone_folder
from hubodo.log.recording_writer import write_recording
from hubodo.log.units import explain_suspect_units
from hubodo.progress import progress_line
from hubodo.recording import Recording, missing_channels
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import add_log_options, add_vehicle_option, stated_input_format
from hubodo.verbs.outputs import add_force_option

EXAMPLE = "hubodo import drive/ -o drive.mcap\n  hubodo import drive.mcap -o again.mcap"


@dataclass(frozen=True)
class ImportResult:
    """The outcome of an import.

    Attributes
    ----------
    log
        Path of the log.
    rows
        Imported rows by file.
    messages
        Number of messages written.
    dropped
        Rows that `--repair` dropped, by file and reason.
    warnings
        One line each.
    """

    log: str
    rows: dict[str, int]
    messages: int
    dropped: dict[str, dict[str, int]]
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {
            "log": self.log,
            "rows": self.rows,
            "messages": self.messages,
            "dropped": self.dropped,
            "warnings": list(self.warnings),
        }

    def render(self, console: Console) -> None:
        """Print one line for each file, then the warnings."""
        for name, count in self.rows.items():
            console.print(f"{name}: {count} rows", highlight=False, markup=False)
        for name, kinds in self.dropped.items():
            reasons = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
            console.print(f"{name}: dropped {reasons}", highlight=False, markup=False)
        for line in self.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)
        console.print(f"wrote {self.log}: {self.messages} messages", highlight=False, markup=False)


@dataclass(frozen=True)
class DecodeResult:
    """The outcome of decoding the raw frames of a log again."""

    source: str
    summary: RedecodedLog

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        done = self.summary
        summary = {
            "log": str(done.out),
            "source": self.source,
            "nodes": done.nodes,
            "messages": done.messages,
        }
        return {**summary, "warnings": list(done.warnings)}

    def render(self, console: Console) -> None:
        """Print one line for each node, then the warnings."""
        lines = [
            f"{name}: {node['samples']} samples, {node['samples_lost']} lost, clock {node['clock']['source']}"
            if node["refused"] is None
            else node["refused"]
            for name, node in self.summary.nodes.items()
        ]
        lines += [f"warning: {line}" for line in self.summary.warnings]
        for line in [*lines, f"wrote {self.summary.out}: {self.summary.messages} messages"]:
            console.print(line, highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo import`."""
    parser.add_argument(
        "source",
        metavar="DIR",
        type=Path,
        help="folder of CSV files (may be gzipped), rosbag or MCAP of another program, one numeric file, or "
        "a log whose raw frames are to be decoded again by this version",
    )
    add_log_options(parser)
    add_vehicle_option(parser)
    parser.add_argument(
        "-o", "--output", metavar="FILE.mcap", type=Path, required=True, help="the log to write"
    )
    parser.add_argument(
        "--repair",
        action="store_true",
        help="drop invalid rows instead of refusing the file, and record how many",
    )
    add_force_option(parser, "output")


def run(args: argparse.Namespace) -> ImportResult | DecodeResult:
    """Read the source and write the log.

    Returns
    -------
    ImportResult or DecodeResult
        Rows by file with the dropped ones, or samples by node.

    Raises
    ------
    InputError
        If a file is invalid, the log exists, or `--repair` is given for a log.
    """
    require_free_path(args.output)
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    form = stated_input_format(args, vehicle)
    file = find_mcap_file(args.source)
    if file is not None and is_hubodo_mcap(file):
        if args.repair:
            raise InputError("--repair drops rows of CSV files; repair a log with hubodo recover")
        with progress_line() as show:
            return DecodeResult(str(args.source), redecode_log(file, args.output, progress=show))
    with progress_line() as show:
        is_folder = args.source.is_dir() and not is_rosbag(args.source)
        if args.repair and is_folder and not is_phone_folder(args.source):
            recording = convert_to_si(read_folder(args.source, repair=True, progress=show), form)
        else:
            recording = read_log(args.source, input_format=form, progress=show, keep_empty=True)
        messages = write_recording(recording, args.output, vehicle=vehicle, progress=show)
    return ImportResult(
        log=str(args.output),
        rows={name: len(table) for name, table in recording.files().items()},
        messages=messages,
        dropped={event.source: dict(event.data["dropped"]) for event in recording.events},
        warnings=(*recording.warnings, *_unit_warnings(recording), *_missing_channels(recording)),
    )


def _missing_channels(recording: Recording) -> list[str]:
    """Return a warning for each node that lacks a channel."""
    warnings = []
    for name, table in recording.nodes.items():
        missing = missing_channels(table)
        if missing and len(table):
            warnings.append(
                f"{name} has no {', '.join(missing)}: allan, warmup, filters and heading use the other "
                "channels, fuse and calibrate imu need all six"
            )
    return warnings


def _unit_warnings(recording: Recording) -> list[str]:
    """Return a warning for each node whose values are probably not in SI units."""
    doubts = {name: explain_suspect_units(table.gyro, table.accel) for name, table in recording.nodes.items()}
    return [f"{name}: {doubt}" for name, doubt in doubts.items() if doubt is not None]
