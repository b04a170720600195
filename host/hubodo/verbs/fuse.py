"""`hubodo fuse`: a log and the vehicle's geometry to a track with its uncertainty."""

import argparse
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as TextTable

from hubodo.calibration.file import read_calibration, source_hash
from hubodo.errors import InputError
from hubodo.fuse.absolute import absolute_track
from hubodo.fuse.track import Score, Track, score
from hubodo.fuse.wheels import METHODS, wheel_odometry
from hubodo.log.any_log import read_log
from hubodo.log.csv_table import write_table
from hubodo.log.roles import NODES
from hubodo.recording import Recording, Table
from hubodo.vehicle import load_vehicle
from hubodo.verbs.effect_options import add_effects_option, know_effects
from hubodo.verbs.log_options import LOG_HELP, add_log_options, check_units, log_form
from hubodo.verbs.numbers import number
from hubodo.whole_files import whole_files

EXAMPLE = "hubodo fuse drive.mcap --vehicle vehicle.toml -o out/"

TRACK_COLUMNS = ("t", "x", "y", "heading", "speed", "sigma_x", "sigma_y", "sigma_heading")


@dataclass(frozen=True)
class Fused:
    """What fusion made of a log; `score` only where the log has the truth, `learnt` as fuse.json has it.

    lag: s after a pose that the wheel filter made it from, too; inf: the whole log.
    """

    log: str
    output: str
    track: Track
    methods: tuple[str, ...]
    lag: float
    nodes: tuple[str, ...]
    learnt: Mapping[str, Any]
    calibration: Mapping[str, str] | None
    score: Score | None
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        made: dict[str, Any] = {
            "log": self.log,
            "output": self.output,
            "methods": list(self.methods),
            "wheel_nodes": list(self.nodes),
            "smoothing": _smoothing(self.lag),
            # The graph, too, looks at the whole log for each pose.
            "causal": self.lag == 0.0 and len(self.methods) == 1,
            **self.learnt,
            "calibration": None if self.calibration is None else dict(self.calibration),
            "warnings": list(self.warnings),
        }
        if self.score is not None:
            made["truth"] = {
                k: v for k, v in asdict(self.score).items() if v is not None and math.isfinite(v)
            }
        return made

    def render(self, console: Console) -> None:
        track = self.track
        table = TextTable(title=f"{self.log} → {self.output}", show_header=False)
        for method in self.methods:
            table.add_row("method", method)
        table.add_row("duration", f"{track.t[-1] - track.t[0]:.2f} s")
        table.add_row("distance", f"{self.learnt['distance']:.3f} m")
        last = f"{track.x[-1]:.3f}, {track.y[-1]:.3f} m, {math.degrees(track.heading[-1]):.2f}°"
        table.add_row("end", last)
        sigma = f"{track.sigma_x[-1]:.3f}, {track.sigma_y[-1]:.3f} m"
        table.add_row("1σ at the end", f"{sigma}, {math.degrees(track.sigma_heading[-1]):.2f}°")
        if self.score is not None:
            found = self.score
            table.add_row("final error", f"{found.final_error:.3f} m, {found.final_percent:.2f} % of path")
            table.add_row("rms error", f"{found.rms_error:.3f} m, {found.rms_percent:.2f} %")
            table.add_row("largest error", f"{found.maximum_error:.3f} m, {found.maximum_percent:.2f} %")
            if found.heading_rms is not None:
                table.add_row("heading rms", f"{math.degrees(found.heading_rms):.2f}°")
        console.print(table)
        for text in self.warnings:
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


def run(args: argparse.Namespace) -> Fused:
    know_effects(args)
    vehicle = load_vehicle(args.vehicle)
    calibration = read_calibration(args.calibration) if args.calibration else None
    files = [args.output / "track.csv", args.output / "fuse.json"]
    taken = next((path for path in files if path.exists()), None)
    if taken is not None and not args.force:
        raise InputError(f"{taken}: exists; name another folder or say --force")
    lag = _lag(args.smooth)
    if lag > 0.0 and args.method != "filter":
        raise InputError("--smooth goes with --method filter")
    needed = (NODES, "wheels") if args.no_graph else (NODES, "wheels", "gnss")
    recording = read_log(args.log, form=log_form(args, vehicle, needed=needed))
    check_units(recording, vehicle.nodes, str(args.log))
    odometry = wheel_odometry(
        recording,
        vehicle,
        log=str(args.log),
        method=args.method,
        nodes=args.nodes.split(",") if args.nodes else None,
        calibration=calibration,
        lag=lag,
    )
    antenna = tuple(args.antenna) if args.antenna else vehicle.antenna or (0.0, 0.0)
    absolute = None if args.no_graph else absolute_track(recording, odometry, antenna)
    known = None
    if args.calibration:
        known = {"file": str(args.calibration), "sha256": source_hash(args.calibration)}
    result = Fused(
        str(args.log),
        str(args.output),
        absolute.track if absolute else odometry.track,
        (odometry.method, absolute.method) if absolute else (odometry.method,),
        lag,
        odometry.nodes,
        {**odometry.learnt, **absolute.learnt} if absolute else odometry.learnt,
        known,
        score_against_truth(absolute.track if absolute else odometry.track, recording),
        recording.warnings + odometry.warnings + (absolute.warnings if absolute else ()),
    )
    with whole_files(*files, make_folder=True) as (track, told):
        write_table(track, Table({name: getattr(result.track, name) for name in TRACK_COLUMNS}))
        told.write_text(json.dumps(result.as_json(), indent=2, allow_nan=False) + "\n", "utf-8")
    return result


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


def _smoothing(lag: float) -> dict[str, Any]:
    if lag == 0.0:
        return {"kind": "none"}
    return {"kind": "fixed lag", "lag": lag} if math.isfinite(lag) else {"kind": "full"}


def score_against_truth(track: Track, recording: Recording) -> Score | None:
    """How far a track is from the truth in its log; None where there is none."""
    truth = recording.truth
    if truth is None:
        return None
    return score(track, truth.t, truth["x"], truth["y"], truth.columns.get("heading"))
