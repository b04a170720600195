"""`hubodo import`: a CSV folder into a log, or the raw frames of a log into another."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from hubodo.atomic_files import require_free_path
from hubodo.errors import InputError
from hubodo.ingest.replay.decode_again import DecodedAgain, decode_again
from hubodo.log.any_log import find_mcap_file, is_hubodo_mcap, is_rosbag, read_log
from hubodo.log.csv_folder import read_folder
from hubodo.log.number_recording import IMU_CHANNELS, convert_to_si
from hubodo.log.recording_writer import write_recording
from hubodo.log.units import explain_suspect_units
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import add_log_options, add_vehicle_option, log_form

EXAMPLE = "hubodo import drive/ -o drive.mcap\n  hubodo import drive.mcap -o again.mcap"


@dataclass(frozen=True)
class Imported:
    """Rows taken from each file, and the account of rows that `--repair` dropped."""

    log: str
    rows: dict[str, int]
    messages: int
    dropped: dict[str, dict[str, int]]
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """As `--json` prints it."""
        return {
            "log": self.log,
            "rows": self.rows,
            "messages": self.messages,
            "dropped": self.dropped,
            "warnings": list(self.warnings),
        }

    def render(self, console: Console) -> None:
        """One line per file."""
        for name, count in self.rows.items():
            console.print(f"{name}: {count} rows", highlight=False, markup=False)
        for name, kinds in self.dropped.items():
            account = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
            console.print(f"{name}: dropped {account}", highlight=False, markup=False)
        for line in self.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)
        console.print(f"wrote {self.log}: {self.messages} messages", highlight=False, markup=False)


@dataclass(frozen=True)
class Decoded:
    """What became of the raw frames of a log."""

    source: str
    done: DecodedAgain

    def as_json(self) -> dict[str, Any]:
        """As `--json` prints it."""
        done = self.done
        made = {"log": str(done.out), "source": self.source, "nodes": done.nodes, "messages": done.messages}
        return {**made, "warnings": list(done.warnings)}

    def render(self, console: Console) -> None:
        """One line per node."""
        lines = [
            f"{name}: {node['samples']} samples, {node['samples_lost']} lost, clock {node['clock']['source']}"
            if node["refused"] is None
            else node["refused"]
            for name, node in self.done.nodes.items()
        ]
        lines += [f"warning: {line}" for line in self.done.warnings]
        for line in [*lines, f"wrote {self.done.out}: {self.done.messages} messages"]:
            console.print(line, highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo import`."""
    parser.add_argument(
        "source",
        metavar="DIR",
        type=Path,
        help="folder of CSV files (may be gzipped), rosbag or MCAP of another program, one file of numbers, "
        "or a log whose raw frames this version is to decode",
    )
    add_log_options(parser)
    add_vehicle_option(parser)
    parser.add_argument(
        "-o", "--output", metavar="FILE.mcap", type=Path, required=True, help="the log to write"
    )
    parser.add_argument(
        "--repair", action="store_true", help="drop rows that would be refused, and keep account of them"
    )


def run(args: argparse.Namespace) -> Imported | Decoded:
    """Read the folder or the frames, write the log."""
    require_free_path(args.output)
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    form = log_form(args, vehicle)
    file = find_mcap_file(args.source)
    if file is not None and is_hubodo_mcap(file):
        if args.repair:
            raise InputError("--repair: drops rows of CSV files; a log is repaired by hubodo recover")
        with progress_line() as show:
            return Decoded(str(args.source), decode_again(file, args.output, progress=show))
    with progress_line() as show:
        if args.source.is_dir() and not is_rosbag(args.source):
            recording = convert_to_si(read_folder(args.source, repair=args.repair, progress=show), form)
        else:
            recording = read_log(args.source, input_format=form, progress=show, keep_empty=True)
        _check_whole(args.source, recording)
        messages = write_recording(recording, args.output, vehicle=vehicle, progress=show)
    return Imported(
        log=str(args.output),
        rows={name: len(table) for name, table in recording.files().items()},
        messages=messages,
        dropped={event.source: dict(event.data["dropped"]) for event in recording.events},
        warnings=(*recording.warnings, *_doubts(recording)),
    )


def _check_whole(source: Path, recording: Recording) -> None:
    """Raises InputError for a node without a channel: a log has all six."""
    for name, table in recording.nodes.items():
        lacking = [channel for channel in IMU_CHANNELS if not np.isfinite(table[channel]).any()]
        if lacking and len(table):
            raise InputError(
                f"{source}: {name} has no {', '.join(lacking)}, and a log holds all six; give the file "
                "itself to hubodo allan or warmup"
            )


def _doubts(recording: Recording) -> list[str]:
    """A line for each node whose numbers look to be in other units."""
    found = {name: explain_suspect_units(table.gyro, table.accel) for name, table in recording.nodes.items()}
    return [f"{name}: {words}" for name, words in found.items() if words is not None]
