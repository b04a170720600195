"""`hubodo warmup`: the bias of a gyro after power-on, as a model that filters use from the first sample."""

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
from hubodo.report.drawing import drawing_path, save
from hubodo.report.page import page
from hubodo.report.warmup import (
    advice,
    parameter_rows,
    prediction_rows,
    warmup_lead,
    warmup_sections,
    whiteness_rows,
)
from hubodo.report.warmup_figure import warmup_figure
from hubodo.sensors.rest_channel import IMU_CHANNELS
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.result import WarmupReport
from hubodo.verbs.numbers import not_negative
from hubodo.verbs.standstill import add_standstill_arguments, read_standstill

EXAMPLE = "hubodo warmup cold_start.mcap --node left --channel gz -o calibration.toml"


@dataclass(frozen=True)
class WarmedUp:
    """The result for one gyro axis, and where it was written."""

    log: str
    node: str
    output: str | None
    report: WarmupReport
    ages: tuple[float, ...]

    def as_json(self) -> dict[str, Any]:
        """The fixed form that programs read, with the log and the node."""
        made = {"log": self.log, "node": self.node, "output": self.output}
        return made | self.report.as_json(self.ages)

    def render(self, console: Console) -> None:
        """The accepted model, tests, the bias at other times."""
        report = self.report
        rows = parameter_rows(report.accepted, report.sigma) if report.accepted is not None else []
        tests = ("test", "result", "verdict")
        kind = "" if report.accepted is None else report.accepted.fit.kind
        _show(console, f"{self.node} {report.channel}: {kind}", ("parameter", "SI", "customary"), rows)
        _show(console, "exponential", tests, whiteness_rows(report.first))
        if report.following is not None:
            _show(console, report.following.fit.kind, tests, whiteness_rows(report.following))
        heads = ("since power-on", "all forms, deg/s", "accepted model, deg/s")
        _show(console, "the bias at other times", heads, prediction_rows(report, self.ages))
        console.print(warmup_lead(report), highlight=False)
        for line in (*(f"note: {note}" for note in report.notes), *advice(report, self.node)):
            console.print(line, highlight=False)
        if self.output:
            console.print(f"written to {self.output}", highlight=False)


def _show(console: Console, title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    table = Table(*heads, title=title)
    for row in rows:
        table.add_row(*row)
    if rows:
        console.print(table)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo warmup`."""
    add_standstill_arguments(parser, IMU_CHANNELS[:3])
    parser.add_argument(
        "--age", type=not_negative, default=0.0, help="s since power-on at the first sample (default 0)"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="TOML", help="calibration file; this axis is added to it"
    )
    parser.add_argument(
        "--at",
        type=not_negative,
        action="append",
        default=[],
        metavar="AGE",
        help="s since power-on for which to forecast the bias, again for each (default: within and after)",
    )
    parser.add_argument(
        "--figure", type=drawing_path, metavar="PNG", help="record, models, forecast: .png, .svg or .pdf"
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a self-contained page")


def run(args: argparse.Namespace) -> WarmedUp:
    """Read, check, fit; add to the calibration file and write the page where asked."""
    data = read_standstill(args)
    try:
        report = characterise_warmup(
            data.t, data.values, data.channel, temperature=data.temperature, age=args.age, step=data.step
        )
        if args.output is not None:
            before = read_calibration(args.output) if args.output.exists() else Calibration()
            node = before.nodes.get(data.node, NodeCalibration())
            span = None
            if data.temperature is not None:
                span = (float(data.temperature.min()), float(data.temperature.max()))
            date, source = datetime.now(UTC).date().isoformat(), hash_source(args.log)
            effects = {
                name: merged(
                    node.effects.get(name), replace(e, date=date, source_sha256=source, temperature=span)
                )
                for name, e in report.effects().items()
            }
            calibration = before.with_node(data.node, effects, data.serial)
            write_calibration(_without_older(calibration, data.node, effects, data.channel[1]), args.output)
    except InputError as error:
        raise InputError(f"{args.log}, node {data.node}, {data.channel}: {error}") from None
    title = f"Warm-up of {data.node} {data.channel}"
    if args.report is not None:
        sections = warmup_sections(report, data.node)
        write_atomically(args.report, page(title, warmup_lead(report), sections))
    if args.figure is not None:
        save(warmup_figure(report, title), args.figure)
    output = None if args.output is None else str(args.output)
    return WarmedUp(str(args.log), data.node, output, report, tuple(args.at))


def _without_older(
    calibration: Calibration, node: str, effects: Mapping[str, CalibratedEffect], axis: str
) -> Calibration:
    """What an earlier model said of this axis and the accepted one does not, taken out."""
    kept = dict(calibration.nodes[node].effects)
    for name in {"gyro_warmup", "gyro_temperature"} & (kept.keys() - effects.keys()):
        left = {key: q for key, q in kept[name].parameters.items() if key[:1] != axis}
        if _axes(left):
            kept[name] = replace(kept[name], parameters=left)
        else:
            del kept[name]
    changed = replace(calibration.nodes[node], effects=kept)
    return replace(calibration, nodes={**calibration.nodes, node: changed})


def merged(old: CalibratedEffect | None, new: CalibratedEffect) -> CalibratedEffect:
    """The new axis beside the axes there are; a time constant, which all axes share, by its weights.

    Raises InputError when the axes' time constants differ by more than 4 sigma: one number cannot stand for
    both.
    """
    if old is None:
        return new
    kept = {name: q for name, q in old.parameters.items() if name[:1] not in _axes(new.parameters)}
    parameters = {**kept, **new.parameters}
    axes = _axes(kept)
    for name in ("time_constant", "time_constant_second"):
        if not axes or name not in kept or name not in new.parameters:
            continue
        before, after = kept[name], new.parameters[name]
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
