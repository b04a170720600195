"""`hubodo fuse`: a log and the vehicle's geometry to a track with its uncertainty."""

import argparse
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from hubodo.config import Vehicle, load_vehicle
from hubodo.errors import InputError
from hubodo.fuse.odometry import DifferentialOdometry, OdometryConfig, OdometryState, WheelSamples, WheelSpec
from hubodo.fuse.track import Score, Track, from_states, score
from hubodo.log.csv_table import write_table
from hubodo.log.mcap import read_recording
from hubodo.log.recording import Recording, Table
from hubodo.model.frames import Side

HELP = "fuse a log into a track: where the vehicle went, with sigmas"
EXAMPLE = "hubodo fuse drive.mcap --vehicle vehicle.toml -o out/"

METHOD = "differential odometry"
SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True)
class Fused:
    """What fusion made of a log; `score` only where the log has the truth."""

    log: str
    output: str
    track: Track
    nodes: dict[str, str]
    gyro_bias: dict[str, dict[str, float]]
    score: Score | None
    warnings: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        made: dict[str, Any] = {
            "log": self.log,
            "output": self.output,
            "methods": [METHOD],
            "nodes": self.nodes,
            "duration": float(self.track.t[-1] - self.track.t[0]),
            "distance": self.track.distance,
            "gyro_bias": self.gyro_bias,
            "calibration": None,
            "warnings": list(self.warnings),
        }
        if self.score is not None:
            made["truth"] = {
                k: v for k, v in asdict(self.score).items() if v is not None and math.isfinite(v)
            }
        return made

    def render(self, console: Console) -> None:
        table = TextTable(title=f"{self.log} → {self.output}", show_header=False)
        table.add_row("method", METHOD)
        table.add_row("nodes", ", ".join(f"{side}: {name}" for side, name in self.nodes.items()))
        table.add_row("duration", f"{self.track.t[-1] - self.track.t[0]:.2f} s")
        table.add_row("distance", f"{self.track.distance:.3f} m")
        last = (
            f"{self.track.x[-1]:.3f}, {self.track.y[-1]:.3f} m, {math.degrees(self.track.heading[-1]):.2f}°"
        )
        table.add_row("end", last)
        sigma = f"{self.track.sigma_x[-1]:.3f}, {self.track.sigma_y[-1]:.3f} m"
        table.add_row("1σ at the end", f"{sigma}, {math.degrees(self.track.sigma_heading[-1]):.2f}°")
        for side, entry in self.gyro_bias.items():
            value, sigma_bias = (math.degrees(entry[k]) for k in ("value", "sigma"))
            table.add_row(f"spin gyro bias, {side}", f"{value:+.4f} ± {sigma_bias:.4f} °/s")
        if self.score is not None:
            found = self.score
            table.add_row(
                "final error", f"{found.final_error:.3f} m, {found.final_percent:.2f} % of the path"
            )
            table.add_row("rms error", f"{found.rms_error:.3f} m, {found.rms_percent:.2f} %")
            table.add_row("largest error", f"{found.maximum_error:.3f} m, {found.maximum_percent:.2f} %")
            if found.heading_rms is not None:
                table.add_row("heading rms", f"{math.degrees(found.heading_rms):.2f}°")
        console.print(table)
        for text in self.warnings:
            console.print(f"warning: {text}", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("log", type=Path, metavar="LOG", help="MCAP recording")
    parser.add_argument("--vehicle", type=Path, required=True, metavar="TOML", help="[vehicle] and [nodes.*]")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT", help="folder for the result"
    )
    parser.add_argument("--force", action="store_true", help="replace results that are there")


def run(args: argparse.Namespace) -> Fused:
    vehicle = load_vehicle(args.vehicle)
    files = [args.output / "track.csv", args.output / "fuse.json"]
    taken = next((path for path in files if path.exists()), None)
    if taken is not None and not args.force:
        raise InputError(f"{taken}: exists; name another folder or say --force")
    recording = read_recording(args.log)
    result = fuse(recording, vehicle, str(args.log), str(args.output))
    args.output.mkdir(parents=True, exist_ok=True)
    track = result.track
    names = ("t", "x", "y", "heading", "speed", "sigma_x", "sigma_y", "sigma_heading")
    write_table(files[0], Table({name: getattr(track, name) for name in names}))
    files[1].write_text(json.dumps(result.as_json(), indent=2, allow_nan=False) + "\n", "utf-8")
    return result


def fuse(recording: Recording, vehicle: Vehicle, log: str, output: str) -> Fused:
    """Differential odometry of the two wheels of a recording.

    Raises InputError when the recording or the vehicle has no node on one of the wheels.
    """
    nodes: dict[Side, str] = {side: _node(recording, vehicle, side, log) for side in SIDES}
    spec = {
        side: WheelSpec(vehicle.wheel_radius, vehicle.nodes[name].facing or "left")
        for side, name in nodes.items()
    }
    odometry = DifferentialOdometry(OdometryConfig(spec["left"], spec["right"], vehicle.track_width))
    states: list[OdometryState] = []
    for side, name in nodes.items():
        states += odometry.handle(_samples(side, recording.nodes[name])).states
    states += odometry.finish()
    if not states:
        raise InputError(f"{log}: {' and '.join(nodes.values())} have no time in common; nothing to fuse")
    track = from_states(states, _start_heading(recording, states[0].t_ns * 1e-9))
    truth = recording.truth
    found = None
    if truth is not None:
        found = score(track, truth.t, truth["x"], truth["y"], truth.columns.get("heading"))
    bias: dict[str, dict[str, float]] = {
        side: {"value": value, "sigma": sigma} for side, (value, sigma) in odometry.biases().items()
    }
    return Fused(
        log, output, track, {str(side): name for side, name in nodes.items()}, bias, found, recording.warnings
    )


def _node(recording: Recording, vehicle: Vehicle, side: Side, log: str) -> str:
    name = vehicle.on(side)
    if name is None:
        raise InputError(
            f"the vehicle file has no node on the {side} wheel; add [nodes.{side}] with its side and facing"
        )
    if name not in recording.nodes:
        there = ", ".join(recording.nodes) or "none"
        raise InputError(
            f"{log}: no node {name!r} in the log (there: {there}); name the nodes in the vehicle file alike"
        )
    return name


def _samples(side: Side, table: Table) -> WheelSamples:
    return WheelSamples(side, np.round(table.t * 1e9).astype(np.int64), table.gyro, table.accel)


def _start_heading(recording: Recording, t: float) -> float:
    """The heading of the truth or of the compass when the track begins, else 0."""
    for table in (recording.truth, recording.heading):
        if table is not None and "heading" in table:
            return float(np.interp(t, table.t, np.unwrap(table["heading"])))
    return 0.0
