"""`hubodo heading`: estimate the heading of a turntable or vehicle from one vertical gyro axis."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.atomic_files import atomic_files, write_atomically
from hubodo.calibration.file import CalibratedEffect, NodeCalibration, read_calibration
from hubodo.calibration.triad import triad_from_effects
from hubodo.errors import InputError
from hubodo.fuse.heading_filter import BiasNoise
from hubodo.log.csv_table import write_table
from hubodo.log.units import check_node_units
from hubodo.pages.page import render_page
from hubodo.recording import Recording, Table
from hubodo.sensors.heading.page import heading_sections, save_heading_figure, summarise_heading
from hubodo.sensors.heading.prior import axis_direction, read_bias_noise, vertical_axis_warmup
from hubodo.sensors.heading.result import HeadingResult
from hubodo.sensors.heading.score import read_true_heading, score_heading
from hubodo.sensors.heading.standstill import (
    DetectedStandstills,
    detect_standstills,
    estimate_angle_random_walk,
    standstills_from_user,
)
from hubodo.sensors.heading.track import estimate_heading
from hubodo.sensors.heading.vertical_axis import Spans, VerticalAxis
from hubodo.sensors.standstill_channel import IMU_CHANNELS, interpolate_temperature
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.verbs.numbers import UNCALIBRATED_SCALE_SIGMA, bounded_number, non_negative_number
from hubodo.verbs.standstill import add_page_options, read_node

EXAMPLE = "hubodo heading drive.mcap --node frame --calibration calibration.toml -o heading.csv"

TYPICAL_GYRO_LAG = 0.005  # s
"""Group delay of a gyro with 30 Hz bandwidth, a common setting of MEMS gyros in vehicles."""
TYPICAL_BIAS_INSTABILITY = math.radians(30.0) / 3600.0
"""B of IEEE 952, rad/s: data sheets of commercial MEMS gyros state 10 to 40 degrees per hour."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo heading`."""
    parser.add_argument(
        "log", type=Path, metavar="LOG", help=f"log that preferably begins with a standstill: {LOG_HELP}"
    )
    add_log_options(parser)
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument("--axis", choices=("x", "y", "z"), default="z", help="vertical gyro axis (default z)")
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="warm-up and scale of the node, as written by hubodo warmup and hubodo calibrate imu",
    )
    parser.add_argument(
        "--age", type=non_negative_number, help="time since power-on at the first sample, s (default 0)"
    )
    parser.add_argument(
        "--allan", type=Path, metavar="JSON", help="noise of the axis, as printed by hubodo allan --json"
    )
    parser.add_argument(
        "--rest",
        type=bounded_number(),
        nargs=2,
        action="append",
        metavar=("FROM", "TO"),
        help="span of a standstill, s of the log; repeatable (default: detected)",
    )
    parser.add_argument(
        "--scale-sigma",
        type=non_negative_number,
        help="1σ of the gyro scale, relative (default: from the calibration, else 0.01)",
    )
    parser.add_argument(
        "--lag",
        type=non_negative_number,
        help="delay of the gyro, s; it contributes to sigma (default: from the calibration, else 0.005)",
    )
    parser.add_argument(
        "--step",
        type=bounded_number(1e-3, 60.0),
        default=0.1,
        help="time step of the output, s (default 0.1)",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="CSV", help="write t,heading,sigma")
    add_page_options(parser, "write the heading with its sigma as .png, .svg or .pdf", "output")


def run(args: argparse.Namespace) -> HeadingResult:
    """Estimate the heading and score it; write CSV, figure and page where asked.

    Returns
    -------
    HeadingResult
        Heading over time with sigma, and its score if the log holds a true heading.

    Raises
    ------
    InputError
        If the node or an axis is missing, the axis is not vertical, or neither standstill nor calibration
        gives the bias.
    """
    form = log_form(args, needed=())
    recording, node = read_node(args.log, args.node, form)
    check_node_units(recording.nodes[node], f"{args.log}, node {node}", form.si_factors())
    try:
        result = _estimate_heading(args, recording, node)
    except InputError as error:
        raise InputError(f"{args.log}, node {node}, {args.axis}: {error}") from None
    if args.output is not None:
        track = result.track
        columns = {"t": track.t, "heading": track.heading + result.start, "sigma": track.sigma}
        with atomic_files(args.output) as (part,):
            write_table(part, Table(columns))
    title = f"Heading of {node} {args.axis}"
    if args.report is not None:
        write_atomically(args.report, render_page(title, summarise_heading(result), heading_sections(result)))
    if args.figure is not None:
        save_heading_figure(result, args.figure, title)
    return result


def _estimate_heading(args: argparse.Namespace, recording: Recording, node: str) -> HeadingResult:
    notes = list(recording.warnings)
    table = recording.nodes[node]
    rows = _complete_rows(table, args.axis, notes)
    t, gyro, accel = table.t[rows], table.gyro[rows], table.accel[rows]
    up, note = axis_direction(accel, args.axis)
    notes += [note] if note else []
    effects = _effects(args.calibration, node)
    index = "xyz".index(args.axis)
    rate = triad_from_effects(effects, "gyro").apply(np.nan_to_num(gyro))[:, index]
    axis = VerticalAxis(t, up * rate, up * gyro[:, index], interpolate_temperature(table, rows))
    model, sigmas = vertical_axis_warmup(effects, args.axis, up, thermometer=axis.temperature is not None)
    if args.rest:
        detected = DetectedStandstills(standstills_from_user(t, args.rest))
    else:
        expected_bias = model.bias(t - t[0] + (args.age or 0.0), axis.temperature)
        detected = detect_standstills(t, gyro, accel, axis, index, expected_bias, recording.table)
    spans = detected.spans
    notes += detected.notes
    if not spans and "gyro_bias" not in effects:
        advice = "; begin with a standstill of about ten seconds, mark one with --rest, or give --calibration"
        problem = f": {detected.problem}" if detected.problem else advice
        raise InputError(f"neither a standstill nor a calibration gives the bias{problem}")
    if not spans:
        notes.append(
            "no standstill: the bias is that of the calibration, with the day-to-day change as its sigma"
        )
    if args.age is None and model.c1:
        notes.append("power-on is assumed at the first sample; if it was earlier, give --age")
    if not model.c1:
        notes.append("no warm-up model of this axis: soon after power-on its bias drifts by more than sigma")
    noise = replace(_bias_noise(args, effects, axis, spans, notes), warmup=sigmas)
    scale_sigma = _scale_sigma(args, effects, notes)
    lag = _gyro_delay(args, effects)
    track = estimate_heading(
        axis, spans, model, noise, age=args.age or 0.0, scale_sigma=scale_sigma, lag=lag, step=args.step
    )
    if track.gaps:
        longest = max(end - start for start, end in track.gaps)
        notes.append(
            f"{len(track.gaps)} gaps, the longest {longest:.3g} s; sigma covers the rotation in them"
        )
    truth = read_true_heading(recording)
    scored = None if truth is None else score_heading(track, truth)
    rests = tuple((float(t[i]), float(t[j - 1])) for i, j in spans)
    return HeadingResult(
        str(args.log),
        None if args.output is None else str(args.output),
        node,
        args.axis,
        up > 0,
        rests,
        model,
        noise,
        scale_sigma,
        lag,
        track,
        scored,
        tuple(notes),
    )


def _complete_rows(table: Table, axis: str, notes: list[str]) -> NDArray[np.int64]:
    """Return the rows with all measured channels; raise InputError without the axis or for too few rows.

    Add a remark for channels that are missing.
    """
    missing = [name for name in IMU_CHANNELS if not np.isfinite(table[name]).any()]
    if f"g{axis}" in missing:
        measured = [name for name in IMU_CHANNELS if name not in missing and name[0] == "g"]
        raise InputError(
            f"it has no g{axis}; choose the vertical axis with --axis"
            + (f" {measured[0][1]}" if len(measured) == 1 else "")
        )
    if missing:
        notes.append(
            f"it has no {', '.join(missing)}: gravity and the other axes cannot confirm a standstill"
        )
    measured_columns = np.column_stack([table[name] for name in IMU_CHANNELS if name not in missing])
    rows = np.flatnonzero(np.isfinite(measured_columns).all(axis=1))
    if len(rows) < 100:
        raise InputError(f"{len(rows)} samples are too few for a heading; record several seconds at least")
    return rows


def _effects(path: Path | None, node: str) -> dict[str, CalibratedEffect]:
    if path is None:
        return {}
    nodes = read_calibration(path).nodes
    if node not in nodes:
        raise InputError(f"{path} holds no node {node!r}; it has {', '.join(nodes) or 'none'}")
    return dict(nodes.get(node, NodeCalibration()).effects)


def _bias_noise(
    args: argparse.Namespace,
    effects: dict[str, CalibratedEffect],
    axis: VerticalAxis,
    spans: Spans,
    notes: list[str],
) -> BiasNoise:
    """Return N, B and K: from `--allan`, else N from standstills, K from the calibration and a typical B."""
    walk = effects.get("gyro_rate_random_walk", CalibratedEffect({})).value("k")
    if args.allan is not None:
        noise = read_bias_noise(args.allan)
        return replace(noise, rate_random_walk=noise.rate_random_walk or walk)
    white_noise = estimate_angle_random_walk(axis.t, axis.rate, spans)
    if white_noise is None:
        raise InputError(
            "no standstill is long enough to estimate the noise of the axis; give --allan, or --rest with "
            "several seconds of standstill"
        )
    notes.append(
        "bias instability assumed as 30 °/h, typical of MEMS gyros; give --allan for the actual value"
    )
    return BiasNoise(white_noise, TYPICAL_BIAS_INSTABILITY, walk)


def _scale_sigma(args: argparse.Namespace, effects: dict[str, CalibratedEffect], notes: list[str]) -> float:
    """Return the relative 1σ of the gyro scale: as given, else calibrated, else typical of MEMS gyros."""
    if args.scale_sigma is not None:
        return float(args.scale_sigma)
    scale = effects.get("gyro_scale_factor", CalibratedEffect({})).parameters.get(args.axis)
    if scale is not None:
        return scale.sigma
    notes.append("the scale is not calibrated: sigma includes 1 % of the net rotation for it")
    return UNCALIBRATED_SCALE_SIGMA


def _gyro_delay(args: argparse.Namespace, effects: dict[str, CalibratedEffect]) -> float:
    """Return the delay of the gyro in seconds: as given, else calibrated, else typical of MEMS gyros."""
    known = effects.get("gyro_lag", CalibratedEffect({})).parameters.get("time_constant")
    if args.lag is not None:
        return float(args.lag)
    return TYPICAL_GYRO_LAG if known is None else math.hypot(known.value, known.sigma)
