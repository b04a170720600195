"""`hubodo fuse`: a log and the vehicle's geometry to a track with its uncertainty."""

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as TextTable

from hubodo.calibration.file import hash_source, read_calibration
from hubodo.errors import InputError
from hubodo.fuse.fused import Fused, check_free, fuse_recording, write_fused
from hubodo.fuse.wheels import METHODS
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.vehicle import load_vehicle
from hubodo.verbs.effect_options import add_effects_option, know_effects
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.verbs.numbers import number

EXAMPLE = "hubodo fuse drive.mcap --vehicle vehicle.toml -o out/"


@dataclass(frozen=True)
class FusedFiles:
    """What fusion made of a log, and where it was written."""

    fused: Fused
    output: str

    def as_json(self) -> dict[str, Any]:
        return self.fused.as_json(self.output)

    def render(self, console: Console) -> None:
        table = TextTable(title=f"{self.fused.log} → {self.output}", show_header=False)
        for what, value in self.fused.facts():
            table.add_row(what, value)
        console.print(table)
        for text in self.fused.warnings:
            console.print(f"warning: {text}", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument("--vehicle", type=Path, required=True, metavar="TOML", help="[vehicle] and [nodes.*]")
    parser.add_argument("--calibration", type=Path, metavar="TOML", help="from `hubodo calibrate`")
    add_effects_option(parser)
    parser.add_argument("--nodes", metavar="NAMES", help="use these wheel nodes alone, such as: left")
    parser.add_argument("--method", choices=METHODS, default="filter", help="default: filter")
    parser.add_argument(
        "--smooth",
        nargs="?",
        const="full",
        metavar="LAG_S",
        help="make each pose from so many seconds after it, too, or from the whole log (full, also where "
        "no number is given); without it, from the past alone",
    )
    parser.add_argument("--no-graph", action="store_true", help="leave GNSS and headings of the log out")
    parser.add_argument(
        "--antenna",
        nargs=2,
        type=number(),
        metavar=("X", "Y"),
        help="m of the GNSS antenna forward and left of midway between the wheels ([vehicle] antenna)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT", help="folder for the result"
    )
    parser.add_argument("--force", action="store_true", help="replace results that are there")


def run(args: argparse.Namespace) -> FusedFiles:
    know_effects(args)
    vehicle = load_vehicle(args.vehicle)
    calibration = read_calibration(args.calibration) if args.calibration else None
    if not args.force:
        check_free(args.output)
    lag = _lag(args.smooth)
    if lag > 0.0 and args.method != "filter":
        raise InputError("--smooth goes with --method filter")
    needed = (NODES_ROLE, "wheels") if args.no_graph else (NODES_ROLE, "wheels", "gnss")
    recording = read_log(args.log, input_format=log_form(args, vehicle, needed=needed))
    known = None
    if args.calibration:
        known = {"file": str(args.calibration), "sha256": hash_source(args.calibration)}
    fused = fuse_recording(
        recording,
        vehicle,
        log=str(args.log),
        method=args.method,
        nodes=args.nodes.split(",") if args.nodes else None,
        calibration=calibration,
        calibration_from=known,
        lag=lag,
        graph=not args.no_graph,
        antenna=tuple(args.antenna) if args.antenna else None,
    )
    write_fused(fused, args.output)
    return FusedFiles(fused, str(args.output))


def _lag(word: str | None) -> float:
    """Seconds of `--smooth`."""
    if word is None:
        return 0.0
    try:
        lag = math.inf if word == "full" else float(word)
    except ValueError:
        lag = math.nan
    if not lag >= 0.0:
        raise InputError(f"--smooth {word}: write seconds from 0 on, or full; put LOG before it")
    return lag
