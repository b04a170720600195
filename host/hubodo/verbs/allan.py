"""`hubodo allan`: Allan deviation, noise terms and best averaging time of stationary sensors."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.atomic_files import write_atomically
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.report.allan import (
    NamedAnalysis,
    allan_page,
    comparison_table,
    explain_term,
    format_duration,
    format_value,
    summarise_allan,
)
from hubodo.report.allan_figure import allan_figure
from hubodo.report.drawing import parse_drawing_path, save_figure
from hubodo.sensors.allan.characterise import AllanAnalysis, characterise_noise
from hubodo.sensors.allan.datasheet import CHIP_DATASHEETS, Datasheet, read_datasheet
from hubodo.sensors.allan.ieee952 import is_gyro, term_units
from hubodo.sensors.standstill_channel import IMU_CHANNELS
from hubodo.verbs.log_options import LOG_HELP, check_nodes, log_form
from hubodo.verbs.numbers import positive_number
from hubodo.verbs.standstill import add_selection_arguments, select_standstill

EXAMPLE = "hubodo allan night.mcap --node left --channel gz --figure gz.png --report gz.html"


@dataclass(frozen=True)
class ChannelAllanResult:
    """The Allan analysis of one channel of a node.

    Attributes
    ----------
    log
        Path of the log.
    node
        Name of the node.
    report
        Allan deviation, fitted noise terms and best averaging time.
    """

    log: str
    node: str
    report: AllanAnalysis

    def as_json(self) -> dict[str, Any]:
        """Return the documented JSON result, with the log and the node."""
        return {"log": self.log, "node": self.node, **self.report.as_json()}

    def render(self, console: Console) -> None:
        """Print the noise terms with their meaning, then the best averaging time."""
        report = self.report
        title = f"{self.node} {report.channel}"
        table = Table("", "term", "value", "± 1σ", "common unit", "meaning", title=title)
        for name, unit in term_units(report.channel).items():
            term = report.fit.terms[name]
            if term.value is None or term.sigma is None:
                limit = "" if term.limit is None else f"below {format_value(term.limit, unit.si)} (95 %); "
                needed = (
                    ""
                    if term.needed is None
                    else f"; a record of {format_duration(term.needed)} would show it"
                )
                table.add_row(name, unit.name, "not observable", "", "", f"{limit}{term.reason}{needed}")
            else:
                table.add_row(
                    name,
                    unit.name,
                    format_value(term.value, unit.si),
                    f"{100 * term.sigma / term.value:.2g} %",
                    format_value(term.value * unit.factor, unit.common),
                    explain_term(name),
                )
        console.print(table)
        console.print(summarise_allan(report), highlight=False)
        for note in report.notes:
            console.print(f"note: {note}", highlight=False)


@dataclass(frozen=True)
class AllanComparison:
    """The Allan analyses of several channels, with data sheets for comparison."""

    sensors: tuple[ChannelAllanResult, ...]
    sheets: tuple[Datasheet, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of each channel under `sensors`, and the data sheets in SI units."""
        return {
            "sensors": [sensor.as_json() for sensor in self.sensors],
            "datasheets": [
                {"name": sheet.name, "gyro": sheet.gyro, "accel": sheet.accel} for sheet in self.sheets
            ],
        }

    def render(self, console: Console) -> None:
        """Print one row for each channel and each data sheet."""
        grid = comparison_table(_named(self.sensors), self.sheets)
        table = Table(*grid.headings, title="common units, ± 1σ")
        for row in grid.rows:
            table.add_row(*row)
        console.print(table)
        for sensor in self.sensors:
            for note in sensor.report.notes:
                console.print(f"note: {sensor.node} {sensor.report.channel}: {note}", highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo allan`."""
    parser.add_argument(
        "log", type=Path, nargs="+", metavar="LOG", help=f"log of stationary sensors: {LOG_HELP}"
    )
    parser.add_argument("--node", help="nodes, separated by commas, or all (default: the only one)")
    parser.add_argument(
        "--channel",
        default="gz",
        help=f"channels, separated by commas: {', '.join(IMU_CHANNELS)} (default gz)",
    )
    add_selection_arguments(parser)
    parser.add_argument(
        "--as-is",
        action="store_true",
        help="use every sample, also disturbed ones: the plain Allan deviation, equal to that of allantools",
    )
    parser.add_argument(
        "--datasheet",
        action="append",
        default=[],
        metavar="TOML|CHIP",
        help=f"compare with a data sheet: a file, or one of {', '.join(CHIP_DATASHEETS)} (repeatable)",
    )
    parser.add_argument(
        "--turn",
        type=positive_number,
        default=2.0,
        help="seconds a maytagging table takes to turn between stops (default 2)",
    )
    parser.add_argument(
        "--per-octave",
        type=int,
        default=1,
        choices=range(1, 13),
        metavar="1..12",
        help="averaging times per octave (default 1)",
    )
    parser.add_argument(
        "--figure", type=parse_drawing_path, metavar="PNG", help="write the log-log plot: .png, .svg or .pdf"
    )
    parser.add_argument("--report", type=Path, metavar="HTML", help="write a self-contained page")


def run(args: argparse.Namespace) -> ChannelAllanResult | AllanComparison:
    """Compute the Allan deviation of each requested channel; write page and figure where asked.

    Returns
    -------
    ChannelAllanResult or AllanComparison
        The analysis of the only channel, or of several channels side by side.

    Raises
    ------
    InputError
        If a channel or node does not exist, gyro and accelerometer are mixed, or the sensor moved.
    """
    channels = _channels(args.channel)
    sheets = tuple(read_datasheet(name) for name in args.datasheet)
    args.channel = channels[0]
    form, sensors = log_form(args, needed=()), []
    for log in args.log:
        with progress_line() as show:
            recording = read_log(log, input_format=form, progress=show)
        for node in _nodes(log, recording, args.node):
            sensors += [_characterised(args, log, recording, node, channel) for channel in channels]
    result: ChannelAllanResult | AllanComparison = (
        sensors[0] if len(sensors) == 1 else AllanComparison(tuple(sensors), sheets)
    )
    named = _named(sensors)
    title = "Allan deviation of " + (named[0][0] if len(named) == 1 else f"{len(named)} channels")
    # The page first: the figure needs a package that may be missing.
    if args.report is not None:
        write_atomically(args.report, allan_page(named, title, sheets))
    if args.figure is not None:
        save_figure(allan_figure(named, title, sheets), args.figure)
    return result


def _characterised(
    args: argparse.Namespace, log: Path, recording: Recording, node: str, channel: str
) -> ChannelAllanResult:
    if args.as_is:
        args.trust_still = True
    data = select_standstill(args, log, recording, node, channel, cut=True)
    try:
        report = characterise_noise(
            data.t,
            data.values,
            channel,
            turn=args.turn,
            per_octave=args.per_octave,
            temperature_step=data.temperature_step,
            excluded=data.disturbances,
            keep_all_samples=args.as_is,
        )
    except InputError as error:
        raise InputError(f"{log}, node {node}, {channel}: {error}") from None
    return ChannelAllanResult(str(log), node, report)


def _channels(text: str) -> list[str]:
    """Return the requested channels without duplicates.

    Raises InputError for an unknown channel, or for gyro and accelerometer together.
    """
    channels = [name.strip() for name in text.split(",")]
    for name in channels:
        if name not in IMU_CHANNELS:
            raise InputError(f"--channel {name!r}: choose from {', '.join(IMU_CHANNELS)}")
    if len({is_gyro(name) for name in channels}) > 1:
        raise InputError(
            f"--channel {text}: gyro and accelerometer have different units; analyse them one after the other"
        )
    return list(dict.fromkeys(channels))


def _nodes(log: Path, recording: Recording, asked: str | None) -> list[str]:
    check_nodes(recording, log)
    nodes = list(recording.nodes)
    if asked == "all" or (asked is None and len(nodes) == 1):
        return nodes
    if asked is None:
        raise InputError(
            f"{log}: holds several nodes; give --node with one of these, or all: {', '.join(nodes)}"
        )
    chosen = [name.strip() for name in asked.split(",")]
    for name in chosen:
        if name not in nodes:
            raise InputError(f"{log}: holds no node {name!r}; give --node with one of: {', '.join(nodes)}")
    return chosen


def _named(sensors: list[ChannelAllanResult] | tuple[ChannelAllanResult, ...]) -> list[NamedAnalysis]:
    """Label each result with node and channel, and with the log where there are several."""
    logs = len({sensor.log for sensor in sensors}) > 1
    return [
        (f"{Path(sensor.log).name} " * logs + f"{sensor.node} {sensor.report.channel}", sensor.report)
        for sensor in sensors
    ]
