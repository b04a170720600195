"""`hubodo north`: the azimuth of a turntable's zero from Earth rate, in logs or live."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hubodo.atomic_files import write_atomically
from hubodo.calibration.apply import apply_calibration
from hubodo.calibration.file import Calibration, read_calibration
from hubodo.errors import InputError
from hubodo.fuse.ranges import node_ranges, of_node
from hubodo.log.any_log import read_log
from hubodo.log.units import check_units
from hubodo.progress import progress_line
from hubodo.recording import Recording, Table
from hubodo.report.drawing import drawing_path, save
from hubodo.report.north import north_figure, north_lead, north_sections
from hubodo.report.page import page
from hubodo.sensors.north.axis_record import AxisRecord, FoundAngles, axis_record, mounted
from hubodo.sensors.north.circle import fuse
from hubodo.sensors.north.find import North, find_north, horizontal_rate
from hubodo.sensors.north.plan import drift_of_allan
from hubodo.sensors.north.seen import METHODS
from hubodo.sensors.north.simulated_table import SimulatedTable, simulate_stops
from hubodo.vehicle import NodeMount
from hubodo.verbs.log_options import add_log_options, log_form
from hubodo.verbs.north_live import check_live, run_live
from hubodo.verbs.north_plan import Planned, run_plan
from hubodo.verbs.north_result import FoundNorth
from hubodo.verbs.numbers import not_negative, number, positive, whole

EXAMPLE = "hubodo north table.mcap --node imu --axis x --latitude-deg 48.1 --method maytag4"

PROGRAMMES = {"maytag": (0.0, 180.0), "maytag4": (0.0, 180.0, 90.0, 270.0), "east": (0.0, 180.0, 90.0, 270.0)}
UNCALIBRATED_SCALE = 0.01
"""1 sigma of the scale of a MEMS gyro as it leaves the factory."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo north`."""
    add = parser.add_argument
    add(
        "log",
        type=Path,
        nargs="*",
        metavar="LOG",
        help="MCAP recording or CSV folder; several of one table that was not moved count together",
    )
    add_log_options(parser)
    add("--latitude-deg", type=number(), required=True, help="north positive")
    add("--node", action="append", help="node; again for each that is to be fused (default: the only one)")
    add(
        "--axis",
        action="append",
        choices=("x", "y", "z"),
        help="gyro axis (default x); again to fuse several",
    )
    add("--method", choices=METHODS, default="maytag", help="how the table was moved (default maytag)")
    add("--near-deg", type=number(), help="about where table zero points; decides between two answers")
    add("--settle", type=not_negative, help="s cut at both ends of each stop (default: found from the data)")
    add("--calibration", type=Path, metavar="TOML", help="all that is known of the nodes' errors")
    _add_found(parser.add_argument_group("stops and angles from the gyro, where there is no table.csv"))
    _add_live(parser.add_argument_group("live, instead of a LOG"))
    noise = parser.add_argument_group("the gyro's noise and what it allows")
    noise.add_argument(
        "--allan", type=Path, metavar="JSON", help="noise of the axis, as hubodo allan --json prints it"
    )
    noise.add_argument(
        "--plan", action="store_true", help="say which stops to make; --allan or a LOG at rest"
    )
    noise.add_argument(
        "--sigma-deg",
        type=number(high=45.0, above=0.0),
        help="wanted (with --plan default 1; live: stops there)",
    )
    noise.add_argument(
        "--turn", type=number(0.0, 3600.0), default=2.0, help="s of a turn, for --plan (default 2)"
    )
    parser.add_argument(
        "--figure",
        type=drawing_path,
        metavar="PNG",
        help="fit and residuals of the first gyro: .png, .svg, .pdf",
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a self-contained page")
    trial = parser.add_argument_group("simulated")
    trial.add_argument(
        "--simulate-azimuth-deg",
        type=number(),
        help="take a record at rest as the gyro's error, on a simulated table whose zero points there",
    )
    trial.add_argument("--stop", type=positive, default=34.0, help="s, simulated and live stops (default 34)")
    trial.add_argument(
        "--stops", type=whole(1, 1_000_000), default=20, help="how many, simulated or live (default 20)"
    )


def _add_found(found: argparse._ArgumentGroup) -> None:
    found.add_argument("--find-stops", action="store_true", help="also where there is a table.csv")
    found.add_argument(
        "--step-deg", type=number(1.0, 180.0), help="the table stops at multiples of this only"
    )
    found.add_argument(
        "--scale-sigma",
        type=number(high=0.2, above=0.0),
        help="1 sigma of the gyro's scale (default: of the calibration, else 0.01)",
    )


def _add_live(live: argparse._ArgumentGroup) -> None:
    live.add_argument("--live", metavar="PORT", help="the port of a node on a table, recorded now")
    live.add_argument(
        "--table", metavar="PORT", help="serial port of the table; without, you are told when to turn it"
    )
    live.add_argument("-o", "--output", type=Path, metavar="FILE.mcap", help="keep the log; must not exist")
    live.add_argument(
        "--resume",
        type=Path,
        action="append",
        default=[],
        metavar="LOG",
        help="go on from the log of a run that was cut short; the table must not have been moved",
    )


def run(args: argparse.Namespace) -> FoundNorth | Planned:
    """Read or record, find north with each axis, put them together."""
    horizontal_rate(math.radians(args.latitude_deg))
    _check(args)
    if args.plan:
        return run_plan(args)
    calibration = None if args.calibration is None else read_calibration(args.calibration)
    live = None
    with progress_line() as show:
        recordings = [
            read_log(log, input_format=log_form(args, needed=()), progress=show)
            for log in args.log or args.resume
        ]
    if args.live is not None:
        check_live(args)
        earlier = _earlier(args, recordings, calibration)
        live = run_live(args, tuple(np.radians(PROGRAMMES[args.method])), calibration, earlier)
        recordings.append(live.recording)
    with progress_line() as show:
        nodes = args.node or ([live.node] if live is not None else _only_node(args, recordings[0]))
        gyros, warnings, used = _gyros(args, recordings, nodes, calibration, show)
    azimuth, sigma = gyros[0][2].azimuth, gyros[0][2].sigma
    if len(gyros) > 1:
        found = [north for *_, north in gyros]
        angle_sigma = max(north.angle_sigma for north in found)
        azimuth, sigma = fuse([(north.posterior, north.horizontal) for north in found], angle_sigma)
    if args.report is not None:
        lead = north_lead(azimuth, sigma)
        write_atomically(args.report, page("North", lead, north_sections(gyros, warnings)))
    if args.figure is not None:
        save(north_figure(gyros[0][2], " ".join(gyros[0][:2])), args.figure)
    return FoundNorth(
        args.latitude_deg,
        azimuth,
        sigma,
        gyros,
        warnings,
        used,
        None if args.simulate_azimuth_deg is None else math.radians(args.simulate_azimuth_deg),
        None if args.output is None else str(args.output),
        None if live is None else live.east,
        None if live is None else live.east_table_angle,
    )


def _check(args: argparse.Namespace) -> None:
    """Raises InputError for arguments that do not go together, or are none."""
    if args.plan:
        return
    if args.sigma_deg is not None and args.live is None:
        raise InputError("--sigma-deg goes with --plan, and with --live PORT")
    if bool(args.log) == (args.live is not None):
        raise InputError("give a LOG, or --live PORT for a node on a table, one of the two")
    if args.live is None and (args.table is not None or args.output is not None or args.resume):
        raise InputError("--table, -o and --resume go with --live PORT")


def _earlier(
    args: argparse.Namespace, recordings: Sequence[Recording], calibration: Calibration | None
) -> Mapping[str, North]:
    """What the logs to go on from tell by themselves, by axis; nothing where they have too few stops yet."""
    if not recordings:
        return {}
    nodes = args.node or _only_node(args, recordings[0])
    try:
        gyros, *_ = _gyros(args, recordings, nodes, calibration, lambda text, share: None)
    except InputError as error:
        print(f"{args.resume[0]}: counts, but tells nothing by itself yet: {error}", file=sys.stderr)
        return {}
    return {axis: north for _, axis, north in gyros}


def _only_node(args: argparse.Namespace, recording: Recording) -> list[str]:
    nodes = list(recording.nodes)
    if len(nodes) != 1:
        raise InputError(f"{_name(args, 0)}: say --node with one of: {', '.join(nodes) or 'none'}")
    return nodes


Gyros = tuple[tuple[str, str, North], ...]


def _gyros(
    args: argparse.Namespace,
    recordings: Sequence[Recording],
    nodes: Sequence[str],
    calibration: Calibration | None,
    show: Callable[[str, float], None],
) -> tuple[Gyros, tuple[str, ...], Mapping[str, Any]]:
    """(node, axis, what it found) of each axis asked for, the warnings of all, the calibration as applied."""
    wanted = [(node, axis) for node in nodes for axis in args.axis or ["x"]]
    gyros: list[tuple[str, str, North]] = []
    warnings: list[str] = []
    corrected: list[Mapping[str, Table]] = []
    used: dict[str, Any] = {}
    for place, recording in enumerate(recordings):
        check_units(recording, nodes, _name(args, place))
        tables, applied, said = _corrected(_name(args, place), recording, nodes, calibration)
        corrected.append(tables)
        used |= applied
        warnings += said
    drift = None if args.allan is None else drift_of_allan(args.allan)
    for node, axis in wanted:
        show(f"{node} {axis}", len(gyros) / len(wanted))
        records = []
        for recording, tables in zip(recordings, corrected, strict=True):
            record, said = _record(args, recording, tables[node], axis, calibration, node)
            records.append(record)
            warnings += [f"{node} {axis}: {text}" for text in said]
        near = None if args.near_deg is None else math.radians(args.near_deg)
        latitude = math.radians(args.latitude_deg)
        found = find_north(records, latitude, args.method, settle=args.settle, near=near, drift=drift)
        gyros.append((node, axis, found))
        warnings += [f"{node} {axis}: {text}" for text in found.warnings]
    return tuple(gyros), tuple(dict.fromkeys(warnings)), used


def _name(args: argparse.Namespace, place: int) -> str:
    logs = args.log or args.resume
    return str(logs[place]) if place < len(logs) else "the recording"


def _corrected(
    log: str, recording: Recording, nodes: Sequence[str], calibration: Calibration | None
) -> tuple[Mapping[str, Table], Mapping[str, Any], list[str]]:
    """The nodes asked for with the calibration applied, what of it was, and what must be said."""
    for node in nodes:
        if node not in recording.nodes:
            raise InputError(f"{log}: holds no node {node!r}; it has {', '.join(recording.nodes) or 'none'}")
        if calibration is not None and node not in calibration.nodes:
            known = ", ".join(calibration.nodes) or "none"
            raise InputError(f"--calibration holds no node {node!r}; it has {known}")
    tables = {node: recording.nodes[node] for node in nodes}
    if calibration is None:
        return tables, {}, []
    applied = apply_calibration(
        tables,
        calibration,
        metadata=recording.metadata,
        events=recording.events,
        t_zero_ns=recording.t_zero_ns,
    )
    return applied.nodes, applied.summaries, list(applied.warnings)


def _record(
    args: argparse.Namespace,
    recording: Recording,
    node: Table,
    axis: str,
    calibration: Calibration | None,
    name: str,
) -> tuple[AxisRecord, list[str]]:
    """One axis of one recording, on its table, on the one found, or on a simulated one."""
    if args.simulate_azimuth_deg is not None:
        return _simulated(args, node, axis)
    latitude = math.radians(args.latitude_deg)
    table = None if args.find_stops else recording.table
    if table is None and args.method == "carousel":
        raise InputError("a carousel needs table.csv (t,angle,moving): turns alone do not tell its angle")
    if table is None and len(args.log or args.resume) + (args.live is not None) > 1:
        raise InputError("several logs count together only where table.csv tells their common angles")
    step = None if args.step_deg is None else math.radians(args.step_deg)
    ranges = node_ranges(NodeMount(), of_node(recording.metadata, name), recording.nodes[name])
    limit = ranges.limits["gyro_limit"]
    found = FoundAngles(_scale_sigma(args, calibration, name), step, limit)
    return axis_record(node, axis, table, latitude, found)


def _scale_sigma(args: argparse.Namespace, calibration: Calibration | None, node: str) -> float:
    """1 sigma of the relative scale: as given, else the calibration's, else that of a gyro off the shelf."""
    if args.scale_sigma is not None:
        return float(args.scale_sigma)
    if calibration is not None and "gyro_scale_factor" in calibration.nodes[node].effects:
        known = calibration.nodes[node].effects["gyro_scale_factor"].parameters.values()
        return max(quantity.sigma for quantity in known)
    return UNCALIBRATED_SCALE


def _simulated(args: argparse.Namespace, node: Table, axis: str) -> tuple[AxisRecord, list[str]]:
    """The record at rest as the error of a gyro on a table that makes the method's stops."""
    if args.method not in PROGRAMMES:
        raise InputError(f"--simulate-azimuth-deg makes stops; it cannot be used with --method {args.method}")
    angles = np.resize(np.radians(PROGRAMMES[args.method]), max(0, args.stops))
    if len(angles) < 4 or not args.stop > 1:
        raise InputError(f"--stops {args.stops} --stop {args.stop}: give 4 stops of more than 1 s at least")
    mount = mounted(node, axis)
    azimuth = math.radians(args.simulate_azimuth_deg) - mount.mounting
    dt = float(np.median(np.diff(node.t)))
    table = SimulatedTable(node["g" + axis], dt, azimuth, math.radians(args.latitude_deg))
    t, rate, made = simulate_stops(table, angles, args.stop)
    return AxisRecord(t, rate, made, mount.mounting), list(mount.warnings)
