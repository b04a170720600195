"""Options and checks that the verbs of sensors share: a stationary channel, a figure and a page."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.number_recording import InputFormat
from hubodo.log.units import si_factor
from hubodo.pages.drawing import parse_drawing_path
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.sensors.standstill_channel import IMU_CHANNELS, StandstillRecord, read_standstill_channel
from hubodo.verbs.log_options import LOG_HELP, add_log_options, check_nodes, split_units, stated_input_format
from hubodo.verbs.numbers import bounded_number
from hubodo.verbs.outputs import add_force_option, add_units_option, html_path

_DEFAULT_FORM = InputFormat()


def add_standstill_arguments(parser: argparse.ArgumentParser, channels: Sequence[str] = IMU_CHANNELS) -> None:
    """Add LOG, --node, --channel, and the options of `add_selection_arguments`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=f"log of a stationary sensor: {LOG_HELP}")
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument("--channel", choices=channels, default="gz", help="channel of the node (default gz)")
    add_selection_arguments(parser)


def add_selection_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --start, --end, --trust-units, --trust-still, and the options for foreign files."""
    parser.add_argument(
        "--start", type=bounded_number(), help="ignore samples before this time of the log, s"
    )
    parser.add_argument("--end", type=bounded_number(), help="ignore samples after this time of the log, s")
    parser.add_argument("--trust-units", action="store_true", help="do not check the unit by the magnitude")
    parser.add_argument("--trust-still", action="store_true", help="do not check for movement")
    add_log_options(parser)


def add_page_options(parser: argparse.ArgumentParser, figure_help: str, *outputs: str) -> None:
    """Add --units, --figure, --report and --force; outputs: further options that --force replaces."""
    add_units_option(parser)
    parser.add_argument("--figure", type=parse_drawing_path, metavar="PNG", help=figure_help)
    parser.add_argument("--report", type=html_path, metavar="HTML", help="write a self-contained page")
    add_force_option(parser, "figure", "report", *outputs)


def read_standstill(args: argparse.Namespace) -> StandstillRecord:
    """Read the log and return the checked channel of --channel.

    Raises InputError for an unknown node, an empty span, a wrong unit, or movement.
    """
    recording, node = read_node(args.log, args.node, stated_input_format(args, needed=()))
    return select_standstill(args, args.log, recording, node, args.channel)


def select_standstill(
    args: argparse.Namespace, log: Path, recording: Recording, node: str, channel: str, *, cut: bool = False
) -> StandstillRecord:
    """Return one checked channel of a log; `cut` lists movement in `disturbed` instead of refusing it."""
    return read_standstill_channel(
        recording,
        node,
        channel,
        log=str(log),
        start=args.start,
        end=args.end,
        trust_units=args.trust_units,
        stated_units=frozenset(si_factor(unit)[0] for unit in split_units(args.unit)),
        trust_still=args.trust_still,
        cut_disturbances=cut,
    )


def read_node(log: Path, name: str | None, form: InputFormat = _DEFAULT_FORM) -> tuple[Recording, str]:
    """Return the log and the named or only node; raise InputError if there is no such node."""
    with progress_line() as show:
        recording = read_log(log, input_format=form, progress=show)
    check_nodes(recording, log)
    return recording, choose_node(recording, name, log)


def choose_node(recording: Recording, name: str | None, log: Path) -> str:
    """Return the named or only node of a log; raise InputError if there is no such node."""
    nodes = tuple(recording.nodes)
    node = name or (nodes[0] if len(nodes) == 1 else None)
    if node is None or node not in recording.nodes:
        problem = f"holds no node {node!r}" if node else "holds several nodes"
        raise InputError(f"{log}: {problem}; give --node with one of: {', '.join(nodes) or 'none'}")
    return node
