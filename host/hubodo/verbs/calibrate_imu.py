"""`hubodo calibrate imu`: bias, scale and cross-axis terms of both sensors from nine or more static poses."""

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
from hubodo.report.imu import format_held_out, imu_sections
from hubodo.report.page import render_page
from hubodo.sensors.imu.calibrate import ImuCalibration, calibrate_imu
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.verbs.numbers import latitude, positive_number

HELP = "bias, scale and cross-axis terms of accelerometer and gyro, from nine or more static poses"
EXAMPLE = "hubodo calibrate imu poses.mcap --node left --gravity 9.81744 -o calibration.toml"


@dataclass(frozen=True)
class ImuCalibrationResult:
    """The IMU calibration of one node, and the file that it was added to."""

    node: str
    output: str
    result: ImuCalibration

    def as_json(self) -> dict[str, Any]:
        """Return effects with sigmas, residuals before and after, static poses and notes for `--json`."""
        calibration = self.result
        effects = {
            name: {p: {"value": q.value, "sigma": q.sigma} for p, q in parameters.items()}
            for name, parameters in calibration.effect_parameters().items()
        }
        result: dict[str, Any] = {
            "node": self.node,
            "output": self.output,
            "gravity": calibration.gravity,
            "effects": effects,
            "covariance": {
                "order": "b_x b_y b_z, then M row by row",
                "accel": calibration.accel.full_covariance.tolist(),
                "gyro": calibration.gyro.covariance.tolist(),
            },
            "poses": {"count": calibration.accel.poses.count, "condition": calibration.accel.poses.condition},
            "rests": [
                {"t": list(map(float, t)), "accel": list(map(float, a)), "residual": float(r)}
                for t, a, r in zip(
                    calibration.standstills.t,
                    calibration.standstills.accel,
                    calibration.accel.residual,
                    strict=True,
                )
            ],
            "accel_norm": {
                "before_rms": _rms(calibration.accel.residual_before),
                "after_rms": _rms(calibration.accel.residual),
            },
            "notes": list(calibration.notes),
        }
        if calibration.accel_held_out is not None:
            held = calibration.accel_held_out
            result["accel_norm_held_out"] = {"before_rms": held.rms_before, "after_rms": held.rms}
        if calibration.gyro.held_out is not None:
            turns = calibration.gyro.held_out
            result["turns_held_out_deg"] = {
                "before_rms": math.degrees(turns.rms_before),
                "after_rms": math.degrees(turns.rms),
                "after_maximum": math.degrees(float(turns.error.max())),
            }
        return result

    def render(self, console: Console) -> None:
        """Print the parameters, then the residuals before and after calibration."""
        calibration = self.result
        table = TextTable("effect", "parameter", "value", "1σ", title=f"{self.node} → {self.output}")
        for name, parameters in calibration.effect_parameters().items():
            for parameter, q in parameters.items():
                table.add_row(name, parameter, f"{q.value:+.6g}", f"{q.sigma:.2g}")
        console.print(table)
        console.print(
            f"length of gravity: {format_held_out(calibration.accel_held_out, 'm/s²')}", highlight=False
        )
        if calibration.gyro.turns is not None:
            words = format_held_out(calibration.gyro.held_out, "degrees", 180 / math.pi)
            console.print(f"turns: {words}", highlight=False)
        for note in calibration.notes:
            console.print(f"note: {note}", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo calibrate imu`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument("--node", required=True, help="name of the node")
    parser.add_argument(
        "--gravity", type=positive_number, default=9.80665, help="local gravity, m/s² (default 9.80665)"
    )
    parser.add_argument(
        "--latitude-deg", type=latitude, help="latitude; makes Earth rate the reference of precise gyros"
    )
    parser.add_argument(
        "--table-rate-deg-s",
        type=positive_number,
        help="constant rate of a rate table, as the reference of the gyro",
    )
    parser.add_argument(
        "--convention",
        choices=("symmetric", "x-first"),
        default="symmetric",
        help="accelerometer frame: symmetric cross-axis matrix, or x axis along sensor x (default symmetric)",
    )
    parser.add_argument(
        "--min-rest",
        type=positive_number,
        default=1.0,
        help="shortest standstill that counts as a pose, s (default 1)",
    )
    parser.add_argument(
        "--report", type=Path, metavar="HTML", help="write a page with poses, parameters and residuals"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="TOML",
        help="calibration file to create or extend",
    )


def run(args: argparse.Namespace) -> ImuCalibrationResult:
    """Calibrate both sensors of the node, and add the result to the calibration file.

    Returns
    -------
    ImuCalibrationResult
        The calibration and the file that it was added to.

    Raises
    ------
    InputError
        If the node does not exist, its units are doubtful, or its poses do not suffice.
    """
    with progress_line() as show:
        recording = read_log(args.log, input_format=log_form(args, needed=()), progress=show)
        show("detecting static poses and turns", 0.5)
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
            min_standstill=args.min_rest,
        )
    effects = calibrated_effects(result, table, hash_source(args.log))
    serial = find_node_serial(recording.metadata, args.node)
    write_calibration(before.with_node(args.node, effects, serial), args.output)
    if args.report is not None:
        lead = f"Length of gravity: {format_held_out(result.accel_held_out, 'm/s²')}."
        write_atomically(args.report, render_page(f"Calibration of {args.node}", lead, imu_sections(result)))
    return ImuCalibrationResult(args.node, str(args.output), result)


def calibrated_effects(
    result: ImuCalibration, table: Table, source_sha256: str
) -> dict[str, CalibratedEffect]:
    """Return the calibration as effects for the calibration file, with their provenance."""
    date = datetime.now(UTC).date().isoformat()
    span = None
    if "temperature" in table:
        known = table["temperature"][np.isfinite(table["temperature"])]
        span = (float(known.min()), float(known.max())) if len(known) else None
    methods = {"accel": result.notes[0], "gyro": result.gyro.method}
    return {
        name: CalibratedEffect(parameters, methods[name.partition("_")[0]], source_sha256, date, span)
        for name, parameters in result.effect_parameters().items()
    }


def node_table(recording: Recording, node: str, log: str) -> Table:
    """Return the table of a node; raise InputError with the existing names if there is no such node."""
    if node not in recording.nodes:
        raise InputError(f"{log}: holds no node {node!r}; it has {', '.join(recording.nodes) or 'none'}")
    return recording.nodes[node]


def _rms(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    return float(np.sqrt(np.mean(values**2)))
