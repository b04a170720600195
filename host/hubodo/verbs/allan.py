"""`hubodo allan`: Allan deviation, noise terms and best averaging time of stationary sensors."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.atomic_files import write_atomically
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.pages.console import print_lines, print_table
from hubodo.pages.drawing import save_figure
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.sensors.allan.characterise import characterise_standstill_noise
from hubodo.sensors.allan.datasheet import CHIP_DATASHEETS, Datasheet, read_datasheet
from hubodo.sensors.allan.figure import allan_figure
from hubodo.sensors.allan.ieee952 import is_gyro
from hubodo.sensors.allan.noise_files import NOISE_CHANNELS, imu_filter_yaml, kalibr_yaml
from hubodo.sensors.allan.other_statistics import OTHER_STATISTICS
from hubodo.sensors.allan.page import NamedResult, allan_page, comparison_table
from hubodo.sensors.allan.repeatability import find_bias_repeatability
from hubodo.sensors.allan.result import AllanResult
from hubodo.sensors.standstill_channel import IMU_CHANNELS
from hubodo.spelling import suggest_spelling
from hubodo.verbs.log_options import LOG_HELP, check_nodes, stated_input_format
from hubodo.verbs.numbers import positive_number
from hubodo.verbs.standstill import add_page_options, add_selection_arguments, select_standstill

EXAMPLE = (
    "hubodo allan night.mcap --node left --channel gz --figure gz.png --report gz.html\n"
    "  hubodo allan night.mcap --node left --kalibr imu.yaml --imu-filter imu_filter.yaml"
)


@dataclass(frozen=True)
class AllanComparison:
    """The Allan deviations of several channels, with data sheets for comparison."""

    sensors: tuple[AllanResult, ...]
    sheets: tuple[Datasheet, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of each channel under `sensors`, and the data sheets in SI units."""
        return {
            "sensors": [sensor.as_json() for sensor in self.sensors],
            "bias_repeatability": [it.as_json() for it in find_bias_repeatability(self.sensors)],
            "datasheets": [
                {"name": sheet.name, "gyro": sheet.gyro, "accel": sheet.accel} for sheet in self.sheets
            ],
        }

    def render(self, console: Console) -> None:
        """Print one row for each channel and each data sheet."""
        table = comparison_table(_named(self.sensors), self.sheets)
        print_table(console, table.headings, table.rows, "± 1σ")
        print_lines(console, [it.describe() for it in find_bias_repeatability(self.sensors)])
        for sensor in self.sensors:
            print_lines(console, sensor.notes, label=f"note: {sensor.name}")


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
        "--also",
        type=_also,
        default=(),
        metavar="KINDS",
        help=f"show more of the record: {', '.join(OTHER_STATISTICS)}, separated by commas (modified Allan, "
        "Hadamard and total deviation, spectral density)",
    )
    parser.add_argument(
        "--kalibr",
        type=Path,
        metavar="YAML",
        help="write imu.yaml for kalibr from all six channels of one node: N and K, rms of three axes",
    )
    parser.add_argument(
        "--imu-filter",
        type=Path,
        metavar="YAML",
        help="write gain and zeta of the ROS filter imu_filter_madgwick, likewise",
    )
    add_page_options(parser, "write the log-log plot: .png, .svg or .pdf", "kalibr", "imu_filter")


def run(args: argparse.Namespace) -> AllanResult | AllanComparison:
    """Compute the Allan deviation of each requested channel; write page and figure where asked.

    Returns
    -------
    AllanResult or AllanComparison
        The analysis of the only channel, or of several channels side by side.

    Raises
    ------
    InputError
        If a channel or node does not exist, gyro and accelerometer are mixed, or the sensor moved.
    """
    channels = _channels(args.channel)
    sheets = tuple(read_datasheet(name) for name in args.datasheet)
    args.channel = channels[0]
    form, sensors = stated_input_format(args, needed=()), []
    for log in args.log:
        with progress_line() as show:
            recording = read_log(log, input_format=form, progress=show)
        nodes = _nodes(log, recording, args.node)
        if (args.kalibr or args.imu_filter) and len(nodes) * len(args.log) > 1:
            raise InputError("--kalibr and --imu-filter describe one node; name one log, and one with --node")
        for node in nodes:
            sensors += [_characterised(args, log, recording, node, channel) for channel in channels]
            last = log, recording, node
    _write_noise_files(args, sensors, *last)
    result: AllanResult | AllanComparison = (
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


def _write_noise_files(
    args: argparse.Namespace, sensors: Sequence[AllanResult], log: Path, recording: Recording, node: str
) -> None:
    """Write the files for other programs, from all channels of the only node; see `noise_files`."""
    outputs = ((args.kalibr, kalibr_yaml), (args.imu_filter, imu_filter_yaml))
    if not any(path for path, _ in outputs):
        return
    known = {sensor.channel: sensor for sensor in sensors}
    results = [
        known.get(channel) or _characterised(args, log, recording, node, channel)
        for channel in NOISE_CHANNELS
    ]
    for path, write in outputs:
        if path is not None:
            write_atomically(path, write(results))


def _characterised(
    args: argparse.Namespace, log: Path, recording: Recording, node: str, channel: str
) -> AllanResult:
    if args.as_is:
        args.trust_still = True
    standstill = select_standstill(args, log, recording, node, channel, cut=True)
    result = characterise_standstill_noise(
        standstill, turn=args.turn, per_octave=args.per_octave, keep_all_samples=args.as_is
    )
    return replace(result, log=str(log), also=args.also)


def _also(text: str) -> tuple[str, ...]:
    """Return the requested kinds without duplicates; raise ArgumentTypeError for an unknown one."""
    kinds = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in kinds:
        if name not in OTHER_STATISTICS:
            raise argparse.ArgumentTypeError(
                f"{name!r}: choose from {', '.join(OTHER_STATISTICS)}"
                f"{suggest_spelling(name, OTHER_STATISTICS)}"
            )
    return kinds


def _channels(text: str) -> list[str]:
    """Return the requested channels without duplicates.

    Raises InputError for an unknown channel, or for gyro and accelerometer together.
    """
    channels = [name.strip() for name in text.split(",")]
    for name in channels:
        if name not in IMU_CHANNELS:
            hint = suggest_spelling(name if len(name) > 1 else f"g{name}", IMU_CHANNELS)
            raise InputError(f"--channel {name!r}: choose from {', '.join(IMU_CHANNELS)}{hint}")
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


def _named(sensors: Sequence[AllanResult]) -> list[NamedResult]:
    """Label each result with node and channel, and with the log where there are several."""
    logs = len({sensor.log for sensor in sensors}) > 1
    return [(f"{Path(sensor.log or '').name} " * logs + sensor.name, sensor) for sensor in sensors]
