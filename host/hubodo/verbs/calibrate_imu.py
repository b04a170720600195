"""`hubodo calibrate imu`: bias, scale and cross-axis of both triads of a node, from nine poses or more."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from hubodo.atomic_files import write_atomically
from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    find_node_serial,
    hash_source,
    read_calibration,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.units import check_node_units
from hubodo.progress import progress_line
from hubodo.recording import Recording, Table
from hubodo.report.imu import held_out_words, imu_sections
from hubodo.report.page import page
from hubodo.sensors.imu.calibrate import ImuCalibration, calibrate_imu
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.verbs.numbers import latitude, positive

HELP = "bias, scale and cross-axis of accelerometers and gyros, from rests in nine or more poses"
EXAMPLE = "hubodo calibrate imu poses.mcap --node left --gravity 9.81744 -o calibration.toml"


@dataclass(frozen=True)
class CalibratedImu:
    """What was found for one node, and where it was written."""

    node: str
    output: str
    result: ImuCalibration

    def as_json(self) -> dict[str, Any]:
        """One object: effects with sigma, residuals before and after, rests, what was used."""
        found = self.result
        effects = {
            name: {p: {"value": q.value, "sigma": q.sigma} for p, q in parameters.items()}
            for name, parameters in found.effects().items()
        }
        made: dict[str, Any] = {
            "node": self.node,
            "output": self.output,
            "gravity": found.gravity,
            "effects": effects,
            "covariance": {
                "order": "b_x b_y b_z, then M row by row",
                "accel": found.accel.full_covariance.tolist(),
                "gyro": found.gyro.covariance.tolist(),
            },
            "poses": {"count": found.accel.poses.count, "condition": found.accel.poses.condition},
            "rests": [
                {"t": list(map(float, t)), "accel": list(map(float, a)), "residual": float(r)}
                for t, a, r in zip(found.rests.t, found.rests.accel, found.accel.residual, strict=True)
            ],
            "accel_norm": {"before_rms": _rms(found.accel.before), "after_rms": _rms(found.accel.residual)},
            "notes": list(found.notes),
        }
        if found.accel_held_out is not None:
            held = found.accel_held_out
            made["accel_norm_held_out"] = {"before_rms": held.rms_before, "after_rms": held.rms}
        if found.gyro.held_out is not None:
            turns = found.gyro.held_out
            made["turns_held_out_deg"] = {
                "before_rms": math.degrees(turns.rms_before),
                "after_rms": math.degrees(turns.rms),
                "after_maximum": math.degrees(float(turns.error.max())),
            }
        return made

    def render(self, console: Console) -> None:
        """A table of the parameters, then before and after."""
        found = self.result
        table = TextTable("effect", "parameter", "value", "1 sigma", title=f"{self.node} → {self.output}")
        for name, parameters in found.effects().items():
            for parameter, q in parameters.items():
                table.add_row(name, parameter, f"{q.value:+.6g}", f"{q.sigma:.2g}")
        console.print(table)
        console.print(f"length of gravity: {held_out_words(found.accel_held_out, 'm/s²')}", highlight=False)
        if found.gyro.turns is not None:
            words = held_out_words(found.gyro.held_out, "degrees", 180 / math.pi)
            console.print(f"turns: {words}", highlight=False)
        for note in found.notes:
            console.print(f"note: {note}", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo calibrate imu`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument("--node", required=True, help="name of the node")
    parser.add_argument(
        "--gravity", type=positive, default=9.80665, help="m/s² at the place (default 9.80665)"
    )
    parser.add_argument(
        "--latitude-deg", type=latitude, help="makes Earth rate the reference of precise gyros"
    )
    parser.add_argument(
        "--table-rate-deg-s", type=positive, help="steady rate of a rate table, the gyros' reference"
    )
    parser.add_argument(
        "--convention",
        choices=("symmetric", "x-first"),
        default="symmetric",
        help="what the accelerometers' frame is: sensors turned least, or sensor x defines x (default "
        "symmetric)",
    )
    parser.add_argument("--min-rest", type=positive, default=1.0, help="shortest rest, s (default 1)")
    parser.add_argument(
        "--report", type=Path, metavar="HTML", help="write a page with rests, parameters, residuals"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="TOML", help="calibration file; added to"
    )


def run(args: argparse.Namespace) -> CalibratedImu:
    """Read, calibrate, add to the calibration file."""
    with progress_line() as show:
        recording = read_log(args.log, input_format=log_form(args, needed=()), progress=show)
        show("rests, poses and turns", 0.5)
        table = node_table(recording, args.node, str(args.log))
        check_node_units(table, f"{args.log}, node {args.node}")
        before = read_calibration(args.output) if args.output.exists() else Calibration()
        result = calibrate_imu(
            table.t,
            table.gyro,
            table.accel,
            gravity=args.gravity,
            latitude=None if args.latitude_deg is None else math.radians(args.latitude_deg),
            table_rate=None if args.table_rate_deg_s is None else math.radians(args.table_rate_deg_s),
            convention=args.convention,
            min_rest=args.min_rest,
        )
    effects = imu_effects(result, table, hash_source(args.log))
    serial = find_node_serial(recording.metadata, args.node)
    write_calibration(before.with_node(args.node, effects, serial), args.output)
    if args.report is not None:
        lead = f"Length of gravity: {held_out_words(result.accel_held_out, 'm/s²')}."
        write_atomically(args.report, page(f"Calibration of {args.node}", lead, imu_sections(result)))
    return CalibratedImu(args.node, str(args.output), result)


def imu_effects(result: ImuCalibration, table: Table, source_sha256: str) -> dict[str, CalibratedEffect]:
    """The result as effects of the calibration file, with where they came from."""
    date = datetime.now(UTC).date().isoformat()
    span = None
    if "temperature" in table:
        known = table["temperature"][np.isfinite(table["temperature"])]
        span = (float(known.min()), float(known.max())) if len(known) else None
    methods = {"accel": result.notes[0], "gyro": result.gyro.method}
    return {
        name: CalibratedEffect(parameters, methods[name.partition("_")[0]], source_sha256, date, span)
        for name, parameters in result.effects().items()
    }


def node_table(recording: Recording, node: str, log: str) -> Table:
    """The table of a node. Raises InputError that lists those there are."""
    if node not in recording.nodes:
        raise InputError(f"{log}: holds no node {node!r}; it has {', '.join(recording.nodes) or 'none'}")
    return recording.nodes[node]


def _rms(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    return float(np.sqrt(np.mean(values**2)))
