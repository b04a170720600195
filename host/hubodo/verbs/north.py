"""`hubodo north`: the azimuth of a turntable's zero from Earth rate, in a log or live."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hubodo.calibration.file import Calibration, NodeCalibration, read_calibration
from hubodo.calibration.triad import triad_from_effects
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.sensors.north.circle import fuse, wrap
from hubodo.sensors.north.east import East
from hubodo.sensors.north.find import METHODS, North, find_north, horizontal_rate
from hubodo.sensors.north.mount import Mount, check_direction, mount_of, tilt_warning
from hubodo.sensors.north.report import advice, advice_words, gyro_json
from hubodo.sensors.north.simulated_table import SimulatedTable, simulate_stops
from hubodo.sensors.north.stops import TableMotion
from hubodo.verbs.log_options import add_log_options, log_form
from hubodo.verbs.north_live import check_live, run_live

EXAMPLE = "hubodo north table.mcap --node imu --axis x --latitude-deg 48.1 --method maytag4"

Array = NDArray[np.float64]
PROGRAMMES = {"maytag": (0.0, 180.0), "maytag4": (0.0, 180.0, 90.0, 270.0), "east": (0.0, 180.0, 90.0, 270.0)}


@dataclass(frozen=True)
class FoundNorth:
    """Azimuth of table zero: from one axis, or from several together."""

    latitude_deg: float
    azimuth: float
    sigma: float
    gyros: tuple[tuple[str, str, North], ...]
    warnings: tuple[str, ...]
    simulated_azimuth: float | None = None
    output: str | None = None
    east: East | None = None
    east_table_angle: float | None = None

    def as_json(self) -> dict[str, Any]:
        """One object; angles in degrees, rates in rad/s, times in s."""
        first = self.gyros[0][2]
        made: dict[str, Any] = {
            "azimuth_deg": math.degrees(self.azimuth) % 360,
            "sigma_deg": math.degrees(self.sigma),
            "rate": [float(r) for r in first.rates],
            "duration": first.elapsed,
            "measured": first.duration,
            "latitude_deg": self.latitude_deg,
            "horizontal_rate": first.horizontal,
            "gyros": [gyro_json(*gyro) for gyro in self.gyros],
            "warnings": list(self.warnings),
            "advice": advice(first),
        }
        if self.output is not None:
            made["output"] = self.output
        if self.east is not None and self.east_table_angle is not None:
            made["east"] = {
                "table_angle_deg": math.degrees(self.east_table_angle) % 360,
                "steps": [
                    {"axis_angle_deg": math.degrees(step.angle), "rate": step.rate}
                    for step in self.east.steps
                ],
            }
        if self.simulated_azimuth is not None:
            made["simulated_azimuth_deg"] = math.degrees(self.simulated_azimuth) % 360
            made["error_deg"] = math.degrees(float(wrap(self.azimuth - self.simulated_azimuth)))
        return made

    def render(self, console: Console) -> None:
        """The azimuth, each gyro with the classical filters, and what the next record should be."""
        console.print(
            f"azimuth of table zero {math.degrees(self.azimuth) % 360:.3f}° ± "
            f"{math.degrees(self.sigma):.3f}° "
            "clockwise from north"
        )
        if self.simulated_azimuth is not None:
            off = math.degrees(float(wrap(self.azimuth - self.simulated_azimuth)))
            console.print(
                f"simulated table at {math.degrees(self.simulated_azimuth) % 360:.3f}°: off by {off:+.3f}°"
            )
        if self.east_table_angle is not None:
            console.print(
                f"the axis points east with the table at {math.degrees(self.east_table_angle) % 360:.2f}°, "
                "where it stands now"
            )
        for node, axis, found in self.gyros:
            drift = found.posterior.drift
            table = Table("", "rate, °/h", "sigma, °/h", "azimuth, °", title=f"{node} {axis}, {found.method}")
            rate, spread = found.components()
            table.add_row("maximum likelihood", _deg_h(rate), _deg_h(spread), _degrees(found.azimuth))
            for name, filtered in found.filters.items():
                cells = (
                    _deg_h(np.array(filtered.rate)),
                    _deg_h(np.array(filtered.sigma)),
                    _degrees(filtered.azimuth),
                )
                table.add_row(name.replace("_", " "), *cells)
            console.print(table)
            console.print(
                f"{found.duration:.0f} s measured in {found.elapsed:.0f} s; white noise alone would leave "
                f"{math.degrees(found.white_bound):.3f}°; fitted N {math.degrees(drift.n) * 60:.3g} °/√h, "
                f"B {math.degrees(drift.b) * 3600:.3g} °/h, K {math.degrees(drift.k) * 3600 * 60:.3g} °/h/√h",
                highlight=False,
            )
        for line in advice_words(self.gyros[0][2]):
            console.print(line, highlight=False)
        for text in self.warnings:
            console.print(f"warning: {text}", highlight=False)
        if self.output is not None:
            console.print(f"recorded to {self.output}", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo north`."""
    parser.add_argument(
        "log", type=Path, nargs="?", metavar="LOG", help="MCAP recording, or a CSV folder, with table.csv"
    )
    add_log_options(parser)
    parser.add_argument(
        "--live", metavar="PORT", help="instead of a LOG: the port of a node on a table, recorded now"
    )
    parser.add_argument(
        "--table",
        metavar="PORT",
        help="with --live: serial port of the table; without, you are told when to turn it by hand",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE.mcap", help="with --live: keep the log; must not exist"
    )
    parser.add_argument(
        "--node", action="append", help="node; again for each that is to be fused (default: the only one)"
    )
    parser.add_argument(
        "--axis",
        action="append",
        choices=("x", "y", "z"),
        help="gyro axis (default x); again to fuse several",
    )
    parser.add_argument("--latitude-deg", type=float, required=True, help="north positive")
    parser.add_argument(
        "--method", choices=METHODS, default="maytag", help="how the table was moved (default maytag)"
    )
    parser.add_argument(
        "--near-deg", type=float, help="about where table zero points; decides between two answers"
    )
    parser.add_argument(
        "--settle", type=float, help="s cut at both ends of each stop (default: found from the data)"
    )
    parser.add_argument(
        "--calibration", type=Path, metavar="TOML", help="gyro scale and cross-axis of the nodes"
    )
    parser.add_argument(
        "--simulate-azimuth-deg",
        type=float,
        help="take a record at rest as the gyro's error, on a simulated table whose zero points there",
    )
    parser.add_argument("--stop", type=float, default=34.0, help="s, simulated and live stops (default 34)")
    parser.add_argument(
        "--stops", type=int, default=20, help="how many stops, simulated or live (default 20)"
    )


def run(args: argparse.Namespace) -> FoundNorth:
    """Read or record, find north with each axis, put them together."""
    horizontal = horizontal_rate(math.radians(args.latitude_deg))
    calibration = read_calibration(args.calibration) if args.calibration is not None else Calibration()
    if (args.log is None) == (args.live is None):
        raise InputError("give a LOG, or --live PORT for a node on a table, one of the two")
    live = None
    if args.live is not None:
        check_live(args)
        live = run_live(args, tuple(np.radians(PROGRAMMES[args.method])), calibration)
    elif args.table is not None or args.output is not None:
        raise InputError("--table and -o go with --live PORT")
    with progress_line() as show:
        if live is None:
            recording, nodes = read_log(args.log, form=log_form(args), progress=show), args.node
        else:
            recording, nodes = live.recording, [live.node]
        gyros, warnings = _gyros(args, recording, nodes or _only_node(args, recording), calibration, show)
    azimuth, sigma = gyros[0][2].azimuth, gyros[0][2].sigma
    if len(gyros) > 1:
        azimuth, sigma = fuse([found.posterior for *_, found in gyros], horizontal)
    return FoundNorth(
        args.latitude_deg,
        azimuth,
        sigma,
        gyros,
        warnings,
        None if args.simulate_azimuth_deg is None else math.radians(args.simulate_azimuth_deg),
        None if args.output is None else str(args.output),
        None if live is None else live.east,
        None if live is None else live.east_table_angle,
    )


def _only_node(args: argparse.Namespace, recording: Recording) -> list[str]:
    nodes = list(recording.nodes)
    if len(nodes) != 1:
        raise InputError(f"{args.log}: say --node with one of: {', '.join(nodes) or 'none'}")
    return nodes


def _gyros(
    args: argparse.Namespace,
    recording: Recording,
    nodes: Sequence[str],
    calibration: Calibration,
    show: Callable[[str, float], None],
) -> tuple[tuple[tuple[str, str, North], ...], tuple[str, ...]]:
    """(node, axis, what it found) of each axis asked for, and the warnings of all."""
    latitude = math.radians(args.latitude_deg)
    simulated = args.simulate_azimuth_deg is not None
    wanted = [(node, axis) for node in nodes for axis in args.axis or ["x"]]
    gyros: list[tuple[str, str, North]] = []
    warnings: list[str] = []
    for node, axis in wanted:
        show(f"{node} {axis}", len(gyros) / len(wanted))
        t, rate, mount, table = _channel(recording, node, axis, args, calibration.nodes)
        found = find_north(
            t,
            rate,
            table,
            latitude,
            args.method,
            mounting=mount.mounting,
            vertical=None if simulated else mount.vertical,
            settle=args.settle,
            near=None if args.near_deg is None else math.radians(args.near_deg),
        )
        gyros.append((node, axis, found))
        warnings += [f"{node} {axis}: {text}" for text in (*mount.warnings, *found.warnings)]
        if not simulated:
            warnings += tilt_warning(mount, t, table, latitude)
    return tuple(gyros), tuple(warnings)


def _channel(
    recording: Recording, node: str, axis: str, args: argparse.Namespace, calibration: Any
) -> tuple[Array, Array, Mount, TableMotion]:
    if node not in recording.nodes:
        raise InputError(f"{args.log}: holds no node {node!r}; it has {', '.join(recording.nodes) or 'none'}")
    data = recording.nodes[node]
    effects = calibration.get(node, NodeCalibration()).effects
    gyro = triad_from_effects(effects, "gyro").apply(data.gyro)
    accel = triad_from_effects(effects, "accel").apply(data.accel)
    mount = mount_of(gyro, accel, axis)
    rate = gyro[:, "xyz".index(axis)]
    if args.simulate_azimuth_deg is not None:
        t, rate, table = _simulate(data.t, rate, mount, args)
        return t, rate, mount, table
    if recording.table is None:
        raise InputError(
            f"{args.log}: has no table.csv (t,angle,moving), which tells where the axis pointed; record it, "
            f"or give "
            "--simulate-azimuth-deg to try the gyro on a simulated table"
        )
    table = TableMotion(recording.table.t, recording.table["angle"], recording.table["moving"] > 0.5)
    check_direction(mount, data.t, table)
    return data.t, rate, mount, table


def _simulate(
    t: Array, rate: Array, mount: Mount, args: argparse.Namespace
) -> tuple[Array, Array, TableMotion]:
    """The record at rest as the error of a gyro on a table that makes the method's stops."""
    if args.method not in PROGRAMMES:
        raise InputError(f"--simulate-azimuth-deg makes stops; it cannot be used with --method {args.method}")
    table = SimulatedTable(
        rate,
        float(np.median(np.diff(t))),
        math.radians(args.simulate_azimuth_deg) - mount.mounting,
        math.radians(args.latitude_deg),
    )
    angles = np.resize(np.radians(PROGRAMMES[args.method]), max(0, args.stops))
    if len(angles) < 4 or not args.stop > 1:
        raise InputError(f"--stops {args.stops} --stop {args.stop}: give 4 stops of more than 1 s at least")
    return simulate_stops(table, angles, args.stop)


def _deg_h(values: Array) -> str:
    return ", ".join(f"{math.degrees(v) * 3600:.3f}" for v in values)


def _degrees(angle: float | None) -> str:
    return "" if angle is None else f"{math.degrees(angle) % 360:.2f}"
