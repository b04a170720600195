"""`hubodo heading`: where a gyro on a turntable or a vehicle points, from the axis that stands upright."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from hubodo.atomic_files import atomic_files, write_atomically
from hubodo.calibration.file import CalibratedEffect, NodeCalibration, read_calibration
from hubodo.calibration.triad import triad_from_effects
from hubodo.errors import InputError
from hubodo.fuse.warm_heading import BiasNoise
from hubodo.log.csv_table import write_table
from hubodo.log.units import check_node_units
from hubodo.recording import Recording, Table
from hubodo.report.drawing import drawing_path
from hubodo.report.heading import heading_figure, heading_lead, heading_sections, score_rows
from hubodo.report.page import page
from hubodo.sensors.heading.prior import noise_of_allan, upright, warmup_upwards
from hubodo.sensors.heading.score import score, truth_of
from hubodo.sensors.heading.standstill import Spans, angle_random_walk, found_rests, given_rests
from hubodo.sensors.heading.summary import HeadingReport
from hubodo.sensors.heading.track import Axis, heading_track
from hubodo.sensors.rest_channel import IMU_CHANNELS, temperature_of
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.verbs.numbers import not_negative, number
from hubodo.verbs.standstill import read_node

EXAMPLE = "hubodo heading drive.mcap --node frame --calibration calibration.toml -o heading.csv"

UNCALIBRATED_SCALE = 0.01
"""1 sigma of the scale of a MEMS gyro as it leaves the factory."""
USUAL_LAG = 0.005
"""s: a gyro of 30 Hz, as MEMS gyros are set for vehicles."""
USUAL_INSTABILITY = math.radians(30.0) / 3600.0
"""rad/s, B of IEEE 952: data sheets of MEMS gyros off the shelf state 10 to 40 degrees an hour."""


@dataclass(frozen=True)
class HeadingTaken:
    """The result for one axis, and where its course was written."""

    log: str
    output: str | None
    report: HeadingReport

    def as_json(self) -> dict[str, Any]:
        """Rates in rad/s, times in s, angles in rad unless the name says degrees."""
        return {"log": self.log, "output": self.output, **self.report.as_json()}

    def render(self, console: Console) -> None:
        """The heading at the end, beside what simpler ways give, and beside the truth."""
        report = self.report
        console.print(heading_lead(report), highlight=False)
        table = TextTable("estimate", *score_rows(report)[0][1:], title=f"{report.node} {report.axis}")
        for row in score_rows(report)[1:]:
            table.add_row(*row)
        console.print(table)
        for note in report.notes:
            console.print(f"note: {note}", highlight=False)
        if self.output:
            console.print(f"written to {self.output}", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo heading`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=f"best begun with a standstill: {LOG_HELP}")
    add_log_options(parser)
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument("--axis", choices=("x", "y", "z"), default="z", help="upright gyro axis (default z)")
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="warm-up and scale of the node, as hubodo warmup and hubodo calibrate imu write them",
    )
    parser.add_argument("--age", type=not_negative, help="s since power-on at the first sample (default 0)")
    parser.add_argument(
        "--allan", type=Path, metavar="JSON", help="noise of the axis, as hubodo allan --json prints it"
    )
    parser.add_argument(
        "--rest",
        type=number(),
        nargs=2,
        action="append",
        metavar=("FROM", "TO"),
        help="s of the log in which the node stood still, again for each (default: found in the log)",
    )
    parser.add_argument(
        "--scale-sigma",
        type=not_negative,
        help="1 sigma of the scale (default: of the calibration, else 0.01)",
    )
    parser.add_argument(
        "--lag",
        type=not_negative,
        help="s by which the gyro answers late (default: of the calibration, else 0.005), part of sigma",
    )
    parser.add_argument(
        "--step", type=number(1e-3, 60.0), default=0.1, help="s from row to row (default 0.1)"
    )
    parser.add_argument("-o", "--output", type=Path, metavar="CSV", help="write t,heading,sigma")
    parser.add_argument(
        "--figure", type=drawing_path, metavar="PNG", help="the course with its sigma: .png, .svg or .pdf"
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a self-contained page")


def run(args: argparse.Namespace) -> HeadingTaken:
    """Read, take the heading, score it; write course, figure and page where asked."""
    recording, node = read_node(args.log, args.node, log_form(args, needed=()))
    check_node_units(recording.nodes[node], f"{args.log}, node {node}")
    try:
        report = _take(args, recording, node)
    except InputError as error:
        raise InputError(f"{args.log}, node {node}, {args.axis}: {error}") from None
    if args.output is not None:
        track = report.track
        columns = {"t": track.t, "heading": track.heading + report.start, "sigma": track.sigma}
        with atomic_files(args.output) as (part,):
            write_table(part, Table(columns))
    title = f"Heading of {node} {args.axis}"
    if args.report is not None:
        write_atomically(args.report, page(title, heading_lead(report), heading_sections(report)))
    if args.figure is not None:
        heading_figure(report, args.figure, title)
    return HeadingTaken(str(args.log), None if args.output is None else str(args.output), report)


def _take(args: argparse.Namespace, recording: Recording, node: str) -> HeadingReport:
    notes = list(recording.warnings)
    table = recording.nodes[node]
    gyro, accel = table.gyro, table.accel
    rows = np.flatnonzero(np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1))
    lacking = [name for name in IMU_CHANNELS if not np.isfinite(table[name]).any()]
    if lacking:
        raise InputError(
            f"it has no {', '.join(lacking)}; a heading needs all axes of gyro and accelerometer"
        )
    if len(rows) < 100:
        raise InputError(f"{len(rows)} samples are too few for a heading; record at least some seconds")
    t, gyro, accel = table.t[rows], gyro[rows], accel[rows]
    up, note = upright(accel, args.axis)
    notes += [note] if note else []
    effects = _effects(args.calibration, node)
    index = "xyz".index(args.axis)
    rate = triad_from_effects(effects, "gyro").apply(gyro)[:, index]
    axis = Axis(t, up * rate, up * gyro[:, index], temperature_of(table, rows))
    if args.rest:
        spans = given_rests(t, args.rest)
    else:
        spans = found_rests(t, gyro, accel, axis.rate, recording.table)
    if not spans and "gyro_bias" not in effects:
        raise InputError(
            "the node never stood still and no calibration tells its bias; begin with a standstill of some "
            "ten seconds, say when it stood with --rest, or give --calibration"
        )
    if not spans:
        notes.append("no standstill: the bias is the calibration's, and sigma what it changes day to day")
    model, sigmas = warmup_upwards(effects, args.axis, up, thermometer=axis.temperature is not None)
    if args.age is None and model.c1:
        notes.append("taken as switched on at the first sample; if it was on before, say --age")
    if not model.c1:
        notes.append(
            "no warm-up of this axis is known: soon after power-on its bias drifts by more than sigma"
        )
    noise = replace(_noise(args, effects, axis, spans, notes), warmup=sigmas)
    scale_sigma = _scale_sigma(args, effects, notes)
    lag = _lag(args, effects)
    track = heading_track(
        axis, spans, model, noise, age=args.age or 0.0, scale_sigma=scale_sigma, lag=lag, step=args.step
    )
    if track.gaps:
        longest = max(b - a for a, b in track.gaps)
        notes.append(f"{len(track.gaps)} gaps, the longest {longest:.3g} s; sigma holds what turned in them")
    truth = truth_of(recording)
    scored = None if truth is None else score(track, truth)
    rests = tuple((float(t[i]), float(t[j - 1])) for i, j in spans)
    return HeadingReport(
        node, args.axis, up > 0, rests, model, noise, scale_sigma, lag, track, scored, tuple(notes)
    )


def _effects(path: Path | None, node: str) -> dict[str, CalibratedEffect]:
    if path is None:
        return {}
    nodes = read_calibration(path).nodes
    if node not in nodes:
        raise InputError(f"{path} holds no node {node!r}; it has {', '.join(nodes) or 'none'}")
    return dict(nodes.get(node, NodeCalibration()).effects)


def _noise(
    args: argparse.Namespace, effects: dict[str, CalibratedEffect], axis: Axis, spans: Spans, notes: list[str]
) -> BiasNoise:
    """N, B, K: from `hubodo allan`, else N from the standstills, K from the calibration, B as is usual."""
    walk = effects.get("gyro_rate_random_walk", CalibratedEffect({})).value("k")
    if args.allan is not None:
        noise = noise_of_allan(args.allan)
        return replace(noise, rate_random_walk=noise.rate_random_walk or walk)
    found = angle_random_walk(axis.t, axis.rate, spans)
    if found is None:
        raise InputError(
            "no standstill is long enough to show the noise of the axis; give --allan, or --rest with some "
            "seconds of standstill"
        )
    notes.append("bias instability taken as 30 °/h, which is usual for MEMS; give --allan to have it right")
    return BiasNoise(found, USUAL_INSTABILITY, walk)


def _scale_sigma(args: argparse.Namespace, effects: dict[str, CalibratedEffect], notes: list[str]) -> float:
    """1 sigma of the relative scale: as given, else the calibration's, else that of a gyro off the shelf."""
    if args.scale_sigma is not None:
        return float(args.scale_sigma)
    scale = effects.get("gyro_scale_factor", CalibratedEffect({})).parameters.get(args.axis)
    if scale is not None:
        return scale.sigma
    notes.append("the scale is not calibrated: one per cent of the net turn is in sigma for it")
    return UNCALIBRATED_SCALE


def _lag(args: argparse.Namespace, effects: dict[str, CalibratedEffect]) -> float:
    """s, how late the gyro answers: as given, else the calibration's, else that of a gyro off the shelf."""
    known = effects.get("gyro_lag", CalibratedEffect({})).parameters.get("time_constant")
    if args.lag is not None:
        return float(args.lag)
    return USUAL_LAG if known is None else math.hypot(known.value, known.sigma)
