"""`hubodo warmup`: model the bias of a gyro after power-on."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.atomic_files import write_atomically
from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    NodeCalibration,
    Quantity,
    hash_source,
    read_calibration,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.report.drawing import parse_drawing_path, save_figure
from hubodo.report.page import render_page
from hubodo.report.warmup import (
    forecast_rows,
    parameter_rows,
    summarise_warmup,
    warmup_advice,
    warmup_sections,
    whiteness_rows,
)
from hubodo.report.warmup_figure import warmup_figure
from hubodo.sensors.standstill_channel import IMU_CHANNELS
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.result import WarmupAnalysis
from hubodo.verbs.numbers import non_negative_number
from hubodo.verbs.standstill import add_standstill_arguments, read_standstill

EXAMPLE = "hubodo warmup cold_start.mcap --node left --channel gz -o calibration.toml"


@dataclass(frozen=True)
class WarmupModelResult:
    """The warm-up model of one gyro axis.

    Attributes
    ----------
    log
        Path of the log.
    node
        Name of the node.
    output
        Path of the calibration file, or None.
    report
        Models, whiteness tests and forecasts.
    ages
        Times since power-on to forecast, s.
    """

    log: str
    node: str
    output: str | None
    report: WarmupAnalysis
    ages: tuple[float, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the documented JSON result, with the log and the node."""
        summary = {"log": self.log, "node": self.node, "output": self.output}
        return summary | self.report.as_json(self.ages)

    def render(self, console: Console) -> None:
        """Print the accepted model, the whiteness tests and the forecast bias."""
        report = self.report
        rows = parameter_rows(report.accepted, report.sigma) if report.accepted is not None else []
        tests = ("test", "result", "verdict")
        kind = "" if report.accepted is None else report.accepted.fit.kind
        _print_table(
            console, f"{self.node} {report.channel}: {kind}", ("parameter", "SI", "common unit"), rows
        )
        _print_table(console, "exponential", tests, whiteness_rows(report.exponential))
        if report.next_model is not None:
            _print_table(console, report.next_model.fit.kind, tests, whiteness_rows(report.next_model))
        headings = ("since power-on", "all models, deg/s", "accepted model, deg/s")
        _print_table(console, "forecast bias", headings, forecast_rows(report, self.ages))
        console.print(summarise_warmup(report), highlight=False)
        for line in (*(f"note: {note}" for note in report.notes), *warmup_advice(report, self.node)):
            console.print(line, highlight=False)
        if self.output:
            console.print(f"written to {self.output}", highlight=False)


def _print_table(
    console: Console, title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    table = Table(*headings, title=title)
    for row in rows:
        table.add_row(*row)
    if rows:
        console.print(table)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo warmup`."""
    add_standstill_arguments(parser, IMU_CHANNELS[:3])
    parser.add_argument(
        "--age",
        type=non_negative_number,
        default=0.0,
        help="time since power-on at the first sample, s (default 0)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="TOML", help="calibration file to create or extend by this axis"
    )
    parser.add_argument(
        "--at",
        type=non_negative_number,
        action="append",
        default=[],
        metavar="AGE",
        help="time since power-on to forecast the bias for, s; repeatable (default: several)",
    )
    parser.add_argument(
        "--figure",
        type=parse_drawing_path,
        metavar="PNG",
        help="write record, models and forecast as .png, .svg or .pdf",
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a self-contained page")


def run(args: argparse.Namespace) -> WarmupModelResult:
    """Fit the warm-up models; extend the calibration file and write page and figure where asked.

    Returns
    -------
    WarmupModelResult
        Models, whiteness tests and forecasts.

    Raises
    ------
    InputError
        If the sensor moved, the record does not suffice, or no model is accepted for the calibration file.
    """
    data = read_standstill(args)
    try:
        report = characterise_warmup(
            data.t,
            data.values,
            data.channel,
            temperature=data.temperature,
            age=args.age,
            temperature_step=data.temperature_step,
        )
        if args.output is not None:
            before = read_calibration(args.output) if args.output.exists() else Calibration()
            node = before.nodes.get(data.node, NodeCalibration())
            span = None
            if data.temperature is not None:
                span = (float(data.temperature.min()), float(data.temperature.max()))
            date, source = datetime.now(UTC).date().isoformat(), hash_source(args.log)
            effects = {
                name: merge_effects(
                    node.effects.get(name), replace(e, date=date, source_sha256=source, temperature=span)
                )
                for name, e in report.calibrated_effects().items()
            }
            calibration = before.with_node(data.node, effects, data.serial)
            write_calibration(
                _remove_superseded(calibration, data.node, effects, data.channel[1]), args.output
            )
    except InputError as error:
        raise InputError(f"{args.log}, node {data.node}, {data.channel}: {error}") from None
    title = f"Warm-up of {data.node} {data.channel}"
    if args.report is not None:
        sections = warmup_sections(report, data.node)
        write_atomically(args.report, render_page(title, summarise_warmup(report), sections))
    if args.figure is not None:
        save_figure(warmup_figure(report, title), args.figure)
    output = None if args.output is None else str(args.output)
    return WarmupModelResult(str(args.log), data.node, output, report, tuple(args.at))


def _remove_superseded(
    calibration: Calibration, node: str, effects: Mapping[str, CalibratedEffect], axis: str
) -> Calibration:
    """Remove warm-up parameters of this axis that an earlier model had and the accepted one does not have."""
    remaining = dict(calibration.nodes[node].effects)
    for name in {"gyro_warmup", "gyro_temperature"} & (remaining.keys() - effects.keys()):
        other_axes = {key: q for key, q in remaining[name].parameters.items() if key[:1] != axis}
        if _axes(other_axes):
            remaining[name] = replace(remaining[name], parameters=other_axes)
        else:
            del remaining[name]
    changed = replace(calibration.nodes[node], effects=remaining)
    return replace(calibration, nodes={**calibration.nodes, node: changed})


def merge_effects(old: CalibratedEffect | None, new: CalibratedEffect) -> CalibratedEffect:
    """Merge the parameters of a new axis into those of the other axes.

    A shared time constant becomes the mean, weighted by inverse variance. Raises InputError if the time
    constants differ by more than 4σ, as one number cannot represent both.
    """
    if old is None:
        return new
    existing = {name: q for name, q in old.parameters.items() if name[:1] not in _axes(new.parameters)}
    parameters = {**existing, **new.parameters}
    axes = _axes(existing)
    for name in ("time_constant", "time_constant_second"):
        if not axes or name not in existing or name not in new.parameters:
            continue
        before, after = existing[name], new.parameters[name]
        if abs(before.value - after.value) > 4.0 * math.hypot(before.sigma, after.sigma):
            raise InputError(
                f"the {name} {after.value:.4g} s differs from {before.value:.4g} s of axis "
                f"{', '.join(sorted(axes))} in the "
                "calibration file, where all axes share one; write the axes to separate files"
            )
        weights = before.sigma**-2, after.sigma**-2
        mean = (weights[0] * before.value + weights[1] * after.value) / sum(weights)
        parameters[name] = Quantity(mean, sum(weights) ** -0.5)
    if not any(name.endswith("_second") and name[:1] in "xyz" for name in parameters):
        parameters.pop("time_constant_second", None)
    return replace(new, parameters=parameters)


def _axes(parameters: Iterable[str]) -> set[str]:
    return {name[:1] for name in parameters if name[:1] in "xyz"}
