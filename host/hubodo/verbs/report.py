"""`hubodo report`: summarise a log on one self-contained HTML page."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.atomic_files import write_atomically
from hubodo.calibration.file import read_calibration
from hubodo.errors import InputError
from hubodo.fuse.wheel.node_screening import check_times
from hubodo.ingest.replay.odometry_setup import OdometrySetup, read_odometry_setup
from hubodo.log.any_log import open_source, read_log
from hubodo.log.logfile import Log
from hubodo.log.summary import summarise_source
from hubodo.progress import progress_line
from hubodo.report.log_page import log_page
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import LOG_HELP, add_log_options, stated_input_format
from hubodo.verbs.numbers import positive_number
from hubodo.verbs.outputs import add_force_option, html_path

EXAMPLE = "hubodo report drive.mcap --vehicle vehicle.toml -o report.html"


@dataclass(frozen=True)
class ReportResult:
    """The report of a log.

    Attributes
    ----------
    log, output
        Paths of the log and of the page.
    size
        Size of the page, bytes.
    facts
        Main results, one line each.
    missing
        Parts that the log does not allow, one line each.
    """

    log: str
    output: str
    size: int
    facts: tuple[str, ...]
    missing: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {
            "log": self.log,
            "output": self.output,
            "size": self.size,
            "facts": list(self.facts),
            "missing": list(self.missing),
        }

    def render(self, console: Console) -> None:
        """Print the main results and the missing parts."""
        for line in self.facts:
            console.print(line, highlight=False, markup=False, soft_wrap=True)
        for line in self.missing:
            console.print(f"not shown: {line}", highlight=False, markup=False, soft_wrap=True)
        console.print(f"{self.output}: {self.size / 1e3:.0f} kB", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo report`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument("-o", "--output", type=html_path, default=Path("report.html"), metavar="HTML")
    parser.add_argument(
        "--vehicle", type=Path, metavar="TOML", help="vehicle file to use instead of that in the log"
    )
    parser.add_argument(
        "--calibration", type=Path, metavar="TOML", help="calibration to use instead of that in the log"
    )
    parser.add_argument(
        "--gravity", type=positive_number, default=9.80665, help="local gravity, m/s² (default 9.80665)"
    )
    add_force_option(parser, "output")


def run(args: argparse.Namespace) -> ReportResult:
    """Analyse the log and write the page.

    Returns
    -------
    ReportResult
        The page, its main results and the parts that are missing.

    Raises
    ------
    InputError
        If the page exists, or the timestamps of the nodes do not belong to one drive.
    """
    if not args.output.absolute().parent.is_dir():
        raise InputError(f"{args.output}: its folder does not exist; create it first")
    with progress_line() as show:
        given_vehicle = None if args.vehicle is None else load_vehicle(args.vehicle)
        recording = read_log(
            args.log, input_format=stated_input_format(args, given_vehicle, needed=()), progress=show
        )
        summary, setup = None, OdometrySetup(None, None, None)
        with open_source(args.log) as source:
            if source is not None:
                summary = summarise_source(source)
            if isinstance(source, Log):
                setup = read_odometry_setup(source)
        vehicle = given_vehicle or setup.vehicle
        if vehicle is not None:
            on_wheels = [name for name, mount in vehicle.nodes.items() if mount.side is not None]
            check_times({n: recording.nodes[n] for n in on_wheels if n in recording.nodes}, str(args.log))
        calibration, where = setup.calibration, "the log"
        if args.calibration is not None:
            calibration, where = read_calibration(args.calibration), str(args.calibration)
        show("analysing the sensors", 0.5)
        report = log_page(
            args.log.name,
            recording,
            summary,
            vehicle=vehicle,
            calibration=calibration,
            calibration_from=where,
            gravity=args.gravity,
        )
    write_atomically(args.output, report.html)
    return ReportResult(
        str(args.log), str(args.output), args.output.stat().st_size, report.facts, report.missing
    )
