"""`hubodo north`: find the azimuth of a turntable's zero from Earth rate, in logs or live."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hubodo.atomic_files import write_atomically
from hubodo.calibration.file import Calibration, read_calibration
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.pages.drawing import save_figure
from hubodo.pages.page import render_page
from hubodo.progress import progress_line
from hubodo.recording import Recording, Table
from hubodo.sensors.north.axis_record import AxisRecord, axis_mount
from hubodo.sensors.north.from_recordings import NorthOptions, north_from_recordings
from hubodo.sensors.north.measurements import METHODS
from hubodo.sensors.north.north_estimate import NorthEstimate, horizontal_earth_rate
from hubodo.sensors.north.page import north_figure, north_sections, summarise_north
from hubodo.sensors.north.plan import StopPlan, read_drift_noise
from hubodo.sensors.north.result import NorthResult
from hubodo.sensors.north.simulated_table import SimulatedTable, simulate_stops
from hubodo.verbs.log_options import add_log_options, stated_input_format
from hubodo.verbs.north_live import check_live_options, record_live
from hubodo.verbs.north_plan import run_plan
from hubodo.verbs.numbers import (
    bounded_integer,
    bounded_number,
    non_negative_number,
    positive_number,
)
from hubodo.verbs.standstill import add_page_options

EXAMPLE = "hubodo north table.mcap --node imu --axis x --latitude-deg 48.1 --method maytag4"

STOP_ANGLES_DEG = {
    "maytag": (0.0, 180.0),
    "maytag4": (0.0, 180.0, 90.0, 270.0),
    "east": (0.0, 180.0, 90.0, 270.0),
}
"""Table angles of the stops of each method, degrees."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo north`."""
    add = parser.add_argument
    add(
        "log",
        type=Path,
        nargs="*",
        metavar="LOG",
        help="MCAP recording or CSV folder; several logs of one table that was not moved are combined",
    )
    add_log_options(parser)
    add("--latitude-deg", type=bounded_number(), required=True, help="latitude, north positive")
    add("--node", action="append", help="node; repeatable, to combine several (default: the only one)")
    add(
        "--axis",
        action="append",
        choices=("x", "y", "z"),
        help="gyro axis (default x); repeatable, to combine several",
    )
    add("--method", choices=METHODS, default="maytag", help="how the table was moved (default maytag)")
    add(
        "--near-deg", type=bounded_number(), help="approximate azimuth of table zero, to resolve an ambiguity"
    )
    add(
        "--settle",
        type=non_negative_number,
        help="time cut off at both ends of each stop, s (default: detected)",
    )
    add("--calibration", type=Path, metavar="TOML", help="calibration of the nodes")
    _add_detection_arguments(parser.add_argument_group("stops and angles from the gyro, without table.csv"))
    _add_live_arguments(parser.add_argument_group("live, instead of a LOG"))
    _add_planning_arguments(parser.add_argument_group("gyro noise and planning"))
    add_page_options(parser, "write fit and residuals of the first gyro as .png, .svg or .pdf")
    _add_simulation_arguments(parser.add_argument_group("simulated and live stops"))


def _add_planning_arguments(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--allan", type=Path, metavar="JSON", help="noise of the axis, as printed by hubodo allan --json"
    )
    group.add_argument(
        "--plan", action="store_true", help="plan the stops, from --allan or a LOG of a stationary node"
    )
    group.add_argument(
        "--sigma-deg",
        type=bounded_number(high=45.0, above=0.0),
        help="requested sigma of the azimuth (default 1 with --plan; a live run ends there)",
    )
    group.add_argument(
        "--turn",
        type=bounded_number(0.0, 3600.0),
        default=2.0,
        help="duration of a turn for --plan, s (default 2)",
    )


def _add_simulation_arguments(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--simulate-azimuth-deg",
        type=bounded_number(),
        help="simulate a table with this azimuth of its zero, with a static record as the gyro error",
    )
    group.add_argument(
        "--stop",
        type=positive_number,
        default=34.0,
        help="duration of simulated and live stops, s (default 34)",
    )
    group.add_argument(
        "--stops",
        type=bounded_integer(1, 1_000_000),
        default=20,
        help="number of simulated or live stops (default 20)",
    )


def _add_detection_arguments(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--find-stops", action="store_true", help="detect the stops even if there is a table.csv"
    )
    group.add_argument(
        "--step-deg", type=bounded_number(1.0, 180.0), help="the table stops only at multiples of this angle"
    )
    group.add_argument(
        "--scale-sigma",
        type=bounded_number(high=0.2, above=0.0),
        help="1σ of the gyro scale, relative (default: from the calibration, else 0.01)",
    )


def _add_live_arguments(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--live", metavar="PORT", help="port of a node on a table, to be recorded now")
    group.add_argument(
        "--table",
        metavar="PORT",
        help="serial port of the table; without it, prompts say when to turn the table by hand",
    )
    group.add_argument(
        "-o", "--output", type=Path, metavar="FILE.mcap", help="log to write; it must not exist"
    )
    group.add_argument(
        "--resume",
        type=Path,
        action="append",
        default=[],
        metavar="LOG",
        help="log of an interrupted run to continue; the table must not have been moved",
    )


def run(args: argparse.Namespace) -> NorthResult | StopPlan:
    """Read or record, estimate north with each axis, and combine the axes.

    Returns
    -------
    NorthResult or StopPlan
        The azimuth of table zero with its sigma, or with --plan the stops to make.

    Raises
    ------
    InputError
        If options contradict each other, a node is missing, or the stops do not suffice.
    LinkError
        If node or table of a live run fail.
    """
    horizontal_earth_rate(math.radians(args.latitude_deg))
    _check_arguments(args)
    if args.plan:
        return run_plan(args)
    calibration = None if args.calibration is None else read_calibration(args.calibration)
    live = None
    with progress_line() as show:
        recordings = [
            read_log(log, input_format=stated_input_format(args, needed=()), progress=show)
            for log in args.log or args.resume
        ]
    if args.live is not None:
        check_live_options(args)
        earlier = _previous_estimates(args, recordings, calibration)
        live = record_live(args, tuple(np.radians(STOP_ANGLES_DEG[args.method])), calibration, earlier)
        recordings.append(live.recording)
    with progress_line() as show:
        nodes = args.node or ([live.node] if live is not None else _only_node(args, recordings[0]))
        result = _estimate(args, recordings, nodes, calibration, show)
    simulated = args.simulate_azimuth_deg
    result = replace(
        result,
        simulated_azimuth=None if simulated is None else math.radians(simulated),
        output=None if args.output is None else str(args.output),
        east=None if live is None else live.east,
        east_table_angle=None if live is None else live.east_table_angle,
    )
    if args.report is not None:
        page = render_page("North", summarise_north(result), north_sections(result))
        write_atomically(args.report, page)
    if args.figure is not None:
        save_figure(north_figure(result.gyros[0], result.gyros[0].name), args.figure)
    return result


def _check_arguments(args: argparse.Namespace) -> None:
    """Raise InputError for options that contradict each other or are missing."""
    if args.plan:
        return
    if args.sigma_deg is not None and args.live is None:
        raise InputError("--sigma-deg goes with --plan, and with --live PORT")
    if bool(args.log) == (args.live is not None):
        raise InputError("give either a LOG, or --live PORT for a node on a table")
    if args.live is None and (args.table is not None or args.output is not None or args.resume):
        raise InputError("--table, -o and --resume go with --live PORT")


def _previous_estimates(
    args: argparse.Namespace, recordings: Sequence[Recording], calibration: Calibration | None
) -> Mapping[str, NorthEstimate]:
    """Return the north estimate by axis from the logs to continue; empty if they hold too few stops."""
    if not recordings:
        return {}
    nodes = args.node or _only_node(args, recordings[0])
    try:
        result = _estimate(args, recordings, nodes, calibration, lambda text, share: None)
    except InputError as error:
        print(f"{args.resume[0]}: used, but not yet sufficient by itself: {error}", file=sys.stderr)
        return {}
    return {north.axis: north for north in result.gyros}


def _only_node(args: argparse.Namespace, recording: Recording) -> list[str]:
    nodes = list(recording.nodes)
    if len(nodes) != 1:
        raise InputError(f"{_log_name(args, 0)}: give --node with one of: {', '.join(nodes) or 'none'}")
    return nodes


def _estimate(
    args: argparse.Namespace,
    recordings: Sequence[Recording],
    nodes: Sequence[str],
    calibration: Calibration | None,
    show: Callable[[str, float], None],
) -> NorthResult:
    """Return the azimuth from each requested axis, and from all of them together."""

    def simulate(node: Table, axis: str) -> tuple[AxisRecord, list[str]]:
        return _simulated_record(args, node, axis)

    options = NorthOptions(
        args.latitude_deg,
        args.axis or ["x"],
        args.method,
        args.near_deg,
        args.settle,
        args.find_stops,
        args.step_deg,
        args.scale_sigma,
        calibration,
        None if args.allan is None else read_drift_noise(args.allan),
        tuple(stated_input_format(args, needed=()).si_factors()),
        None if args.simulate_azimuth_deg is None else simulate,
    )
    named = [(_log_name(args, index), recording) for index, recording in enumerate(recordings)]
    return north_from_recordings(named, nodes, options, show)


def _log_name(args: argparse.Namespace, index: int) -> str:
    logs = args.log or args.resume
    return str(logs[index]) if index < len(logs) else "the recording"


def _simulated_record(args: argparse.Namespace, node: Table, axis: str) -> tuple[AxisRecord, list[str]]:
    """Return the record of a simulated table that makes the stops, with the static record as gyro error."""
    if args.method not in STOP_ANGLES_DEG:
        raise InputError(f"--simulate-azimuth-deg makes stops; it cannot be used with --method {args.method}")
    angles = np.resize(np.radians(STOP_ANGLES_DEG[args.method]), max(0, args.stops))
    if len(angles) < 4 or not args.stop > 1:
        raise InputError(f"--stops {args.stops} --stop {args.stop}: give at least 4 stops of more than 1 s")
    mount = axis_mount(node, axis)
    azimuth = math.radians(args.simulate_azimuth_deg) - mount.mounting_angle
    dt = float(np.median(np.diff(node.t)))
    table = SimulatedTable(node["g" + axis], dt, azimuth, math.radians(args.latitude_deg))
    t, rate, stops = simulate_stops(table, angles, args.stop)
    return AxisRecord(t, rate, stops, mount.mounting_angle), list(mount.warnings)
