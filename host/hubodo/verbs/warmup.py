"""`hubodo warmup`: the bias of a gyro after power-on, as a model that filters use from the first sample."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    NodeCalibration,
    Quantity,
    read_calibration,
    source_hash,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.report.page import page
from hubodo.report.warmup import parameter_rows, warmup_lead, warmup_sections, whiteness_rows
from hubodo.sensors.warmup.characterise import WarmupReport, characterise_warmup
from hubodo.verbs.standstill import CHANNELS, add_standstill_arguments, read_standstill

EXAMPLE = "hubodo warmup cold_start.mcap --node left --channel gz -o calibration.toml"


@dataclass(frozen=True)
class WarmedUp:
    """The result for one gyro axis, and where it was written."""

    log: str
    node: str
    output: str | None
    report: WarmupReport

    def as_json(self) -> dict[str, Any]:
        """The fixed form that programs read, with the log and the node."""
        return {"log": self.log, "node": self.node, "output": self.output, **self.report.as_json()}

    def render(self, console: Console) -> None:
        """Parameters, tests, the next model."""
        report = self.report
        if not report.reason:
            table = Table("parameter", "SI", "customary", title=f"{self.node} {report.channel}")
            for row in parameter_rows(report.first):
                table.add_row(*row)
            console.print(table)
        tests = Table("test", "result", "verdict")
        for row in whiteness_rows(report.first):
            tests.add_row(*row)
        console.print(tests)
        if report.following is not None:
            following = Table(
                "parameter", "SI", "customary", title=f"next model: {report.following.fit.kind}"
            )
            for row in parameter_rows(report.following):
                following.add_row(*row)
            console.print(following)
        console.print(warmup_lead(report), highlight=False)
        for note in report.notes:
            console.print(f"note: {note}", highlight=False)
        if self.output:
            console.print(f"written to {self.output}", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo warmup`."""
    add_standstill_arguments(parser, CHANNELS[:3])
    parser.add_argument(
        "--age", type=float, default=0.0, help="s since power-on at the first sample (default 0)"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="TOML", help="calibration file; this axis is added to it"
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a self-contained page")


def run(args: argparse.Namespace) -> WarmedUp:
    """Read, check, fit; add to the calibration file and write the page where asked."""
    if not (args.age >= 0 and math.isfinite(args.age)):
        raise InputError(f"--age {args.age} must be a time in s since power-on, 0 or more")
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
            date, source = datetime.now(UTC).date().isoformat(), source_hash(args.log)
            effects = {
                name: merged(
                    node.effects.get(name), replace(e, date=date, source_sha256=source, temperature=span)
                )
                for name, e in report.effects().items()
            }
            write_calibration(before.with_node(data.node, effects, data.serial), args.output)
    except InputError as error:
        raise InputError(f"{args.log}, node {data.node}, {data.channel}: {error}") from None
    if args.report is not None:
        title = f"Warm-up of {data.node} {data.channel}"
        args.report.write_text(page(title, warmup_lead(report), warmup_sections(report)), "utf-8")
    return WarmedUp(str(args.log), data.node, None if args.output is None else str(args.output), report)


def merged(old: CalibratedEffect | None, new: CalibratedEffect) -> CalibratedEffect:
    """The new axis beside the axes there are; the time constant, which all axes share, by its weights.

    Raises InputError when the axes' time constants differ by more than 4 sigma: one number cannot stand for
    both.
    """
    if old is None:
        return new
    parameters = {**old.parameters, **new.parameters}
    axes = {name for name in old.parameters if name not in new.parameters}
    if "time_constant" in new.parameters and "time_constant" in old.parameters and axes:
        before, after = old.parameters["time_constant"], new.parameters["time_constant"]
        if abs(before.value - after.value) > 4.0 * math.hypot(before.sigma, after.sigma):
            raise InputError(
                f"the time constant {after.value:.4g} s differs from {before.value:.4g} s of axis "
                f"{', '.join(sorted(axes))} in the "
                "calibration file, where all axes share one; write the axes to separate files"
            )
        weights = before.sigma**-2, after.sigma**-2
        mean = (weights[0] * before.value + weights[1] * after.value) / sum(weights)
        parameters["time_constant"] = Quantity(mean, sum(weights) ** -0.5)
    return replace(new, parameters=parameters)
