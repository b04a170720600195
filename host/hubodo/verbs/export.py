"""`hubodo export`: convert a log into CSV or Parquet files or a rosbag2, or a track into a file for maps."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.atomic_files import write_atomically
from hubodo.errors import InputError
from hubodo.log.any_log import open_as_mcap, read_log
from hubodo.log.csv_folder import write_folder
from hubodo.log.logfile import open_log
from hubodo.log.number_recording import InputFormat
from hubodo.log.rosbag2_folder import write_rosbag2
from hubodo.progress import progress_line
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import LOG_HELP, add_log_options, add_vehicle_option, stated_input_format
from hubodo.verbs.numbers import bounded_number
from hubodo.verbs.outputs import add_force_option

EXAMPLE = (
    "hubodo export drive.mcap -o drive/\n  hubodo export drive.mcap --format rosbag2 -o bag/\n"
    "  hubodo fuse drive.mcap --vehicle vehicle.toml -o out/ && hubodo export out/ --format gpx -o drive.gpx"
)


TRACK_FORMATS = ("tum", "kitti", "gpx", "kml", "geojson")
"""Formats of a track; see `hubodo.fuse.track_files`."""
TRACK_ENTRY = "track"
"""Key of the number of poses in `rows` of a result."""


@dataclass(frozen=True)
class ExportResult:
    """The outcome of an export.

    Attributes
    ----------
    folder
        The folder or file that was written.
    rows
        Rows by file, or messages by topic.
    warnings
        Damage and omissions, one line each.
    """

    folder: str
    rows: dict[str, int]
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {"folder": self.folder, "rows": self.rows, "warnings": list(self.warnings)}

    def render(self, console: Console) -> None:
        """Print one line for each file or topic."""
        for line in self.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)
        for name, count in self.rows.items():
            if name == TRACK_ENTRY:
                console.print(f"{self.folder}: {count} poses", highlight=False, markup=False, soft_wrap=True)
                continue
            line = f"{name}: {count} messages" if name.startswith("/") else f"{name}: {count} rows"
            console.print(f"{self.folder}/{line.lstrip('/')}", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo export`."""
    parser.add_argument(
        "log", metavar="LOG", type=Path, help=f"{LOG_HELP}; for a track also a folder written by hubodo fuse"
    )
    add_log_options(parser)
    add_vehicle_option(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        type=Path,
        required=True,
        help="folder to create, for a track the file",
    )
    parser.add_argument(
        "--format",
        choices=("csv", "parquet", "rosbag2", *TRACK_FORMATS),
        help="by default the suffix of a track, as in track.gpx, else csv; parquet needs pyarrow "
        "(hubodo[parquet]); rosbag2 holds every message, in SQLite, for ros2 bag; the others hold the track, "
        "of a log the odometry recorded live",
    )
    parser.add_argument(
        "--origin",
        nargs=2,
        type=bounded_number(),
        metavar=("LATITUDE", "LONGITUDE"),
        help="start of the track in degrees, with x to the east, for gpx, kml and geojson without GNSS",
    )
    add_force_option(parser, "output")


def run(args: argparse.Namespace) -> ExportResult:
    """Read the log and write the folder.

    Returns
    -------
    ExportResult
        Rows by file, or messages by topic, with warnings.

    Raises
    ------
    InputError
        If the log cannot be read or the folder exists.
    """
    vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
    suffix = args.output.suffix.removeprefix(".").lower()
    if args.format is None:
        args.format = suffix if suffix in TRACK_FORMATS else "csv"
    if args.format == "csv" and suffix in ("csv", "txt", "bag", "mcap", "db3"):
        raise InputError(
            f"-o {args.output}: a folder of CSV files is written, one for each node; name a folder, add "
            f"--format rosbag2, or for the track give --format or a suffix of {', '.join(TRACK_FORMATS)}"
        )
    if args.format in TRACK_FORMATS:
        return _export_track(args, stated_input_format(args, vehicle))
    if args.format == "rosbag2":
        return _export_rosbag2(args, stated_input_format(args, vehicle))
    with progress_line() as show:
        recording = read_log(
            args.log, input_format=stated_input_format(args, vehicle), progress=show, keep_empty=True
        )
        names = write_folder(recording, args.output, table_format=args.format, progress=show)
    counts = [len(table) for table in recording.files().values()]
    return ExportResult(str(args.output), dict(zip(names, counts, strict=True)), recording.warnings)


def _export_track(args: argparse.Namespace, form: InputFormat) -> ExportResult:
    # Imported here: other exports need no odometry.
    from hubodo.fuse.fused_recording import RESULT_FILES
    from hubodo.fuse.track_files import TRACK_WRITERS, is_fused, live_track, read_fused_track

    origin = tuple(args.origin) if args.origin else None
    if args.log.name == RESULT_FILES[0] and is_fused(args.log.parent):
        args.log = args.log.parent
    if is_fused(args.log):
        track = read_fused_track(args.log, origin)
    else:
        with progress_line() as show:
            recording = read_log(args.log, input_format=form, progress=show)
        track = live_track(recording, str(args.log), origin)
    write_atomically(args.output, TRACK_WRITERS[args.format](track))
    return ExportResult(str(args.output), {TRACK_ENTRY: len(track.t)}, ())


def _export_rosbag2(args: argparse.Namespace, form: InputFormat) -> ExportResult:
    with progress_line() as show, open_as_mcap(args.log, form) as file, open_log(file) as log:
        counts = write_rosbag2(log, args.output, progress=show)
        left_out = sorted({stream.topic for stream in log.streams.values()} - set(counts))
        warning = f"{args.log}: left out, as their ROS 2 type is incomplete: {', '.join(left_out)}"
        notes = (warning,) if left_out else ()
        return ExportResult(str(args.output), counts, (*log.warnings(), *notes))
