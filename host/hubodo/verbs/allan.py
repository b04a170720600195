"""`hubodo allan`: what a sensor at rest is worth: Allan deviation, noise terms, how long to average."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.errors import InputError
from hubodo.report.allan import MEANING, allan_lead, allan_sections, duration_words, value_words
from hubodo.report.allan_figure import allan_figure
from hubodo.report.drawing import drawing_path, save
from hubodo.report.page import page
from hubodo.sensors.allan.characterise import AllanReport, characterise
from hubodo.sensors.allan.ieee952 import units
from hubodo.verbs.standstill import add_standstill_arguments, read_standstill

HELP = "Allan deviation and noise terms of a sensor at rest, with sigmas and units of IEEE 952"
EXAMPLE = "hubodo allan night.mcap --node left --channel gz --figure gz.png --report gz.html"


@dataclass(frozen=True)
class Characterised:
    """The result for one channel of a node."""

    log: str
    node: str
    report: AllanReport

    def as_json(self) -> dict[str, Any]:
        """The fixed form that programs read, with the log and the node."""
        return {"log": self.log, "node": self.node, **self.report.as_json()}

    def render(self, console: Console) -> None:
        """The terms with what they mean, then the averaging time."""
        report = self.report
        table = Table(
            "",
            "term",
            "value",
            "± 1 sigma",
            "customary",
            "what it means",
            title=f"{self.node} {report.channel}",
        )
        for name, unit in units(report.channel).items():
            term = report.fit.terms[name]
            if term.value is None or term.sigma is None:
                limit = "" if term.limit is None else f"below {value_words(term.limit, unit.si)} (95 %); "
                wait = (
                    ""
                    if term.needed is None
                    else f"; a record of {duration_words(term.needed)} would show that"
                )
                table.add_row(name, unit.name, "not shown", "", "", f"{limit}{term.reason}{wait}")
            else:
                table.add_row(
                    name,
                    unit.name,
                    value_words(term.value, unit.si),
                    f"{100 * term.sigma / term.value:.2g} %",
                    value_words(term.value * unit.factor, unit.customary),
                    MEANING[name],
                )
        console.print(table)
        console.print(allan_lead(report), highlight=False)
        for note in report.notes:
            console.print(f"note: {note}", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo allan`."""
    add_standstill_arguments(parser)
    parser.add_argument(
        "--turn", type=float, default=2.0, help="s from stop to stop of a maytag table (default 2)"
    )
    parser.add_argument(
        "--per-octave",
        type=int,
        default=1,
        choices=range(1, 13),
        metavar="1..12",
        help="averaging times per octave",
    )
    parser.add_argument(
        "--figure", type=drawing_path, metavar="PNG", help="the log-log figure: .png, .svg or .pdf"
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a self-contained page")


def run(args: argparse.Namespace) -> Characterised:
    """Read, check, characterise; write figure and page where asked."""
    if not args.turn > 0:
        raise InputError(f"--turn {args.turn} must be a positive time in s")
    data = read_standstill(args)
    try:
        report = characterise(
            data.t, data.values, data.channel, turn=args.turn, per_octave=args.per_octave, step=data.step
        )
    except InputError as error:
        raise InputError(f"{args.log}, node {data.node}, {data.channel}: {error}") from None
    if args.report is not None:
        title = f"Allan deviation of {data.node} {data.channel}"
        args.report.write_text(page(title, allan_lead(report), allan_sections(report)), "utf-8")
    if args.figure is not None:
        save(allan_figure([(data.channel, report)], f"{data.node} {data.channel}"), args.figure)
    return Characterised(str(args.log), data.node, report)
