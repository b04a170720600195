"""What `hubodo allan` and `hubodo warmup` share: channels of a node at rest, checked before they are used."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.number_recording import InputFormat
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.sensors.rest_channel import IMU_CHANNELS, Standstill, rest_channel
from hubodo.verbs.log_options import LOG_HELP, add_log_options, check_nodes, log_form
from hubodo.verbs.numbers import number

_AS_IT_IS = InputFormat()


def add_standstill_arguments(parser: argparse.ArgumentParser, channels: Sequence[str] = IMU_CHANNELS) -> None:
    """LOG, --node, --channel, and those of `add_span_arguments`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=f"a sensor at rest: {LOG_HELP}")
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument("--channel", choices=channels, default="gz", help="column of the node (default gz)")
    add_span_arguments(parser)


def add_span_arguments(parser: argparse.ArgumentParser) -> None:
    """--start, --end, --trust-units, --trust-still, and how to read foreign files."""
    parser.add_argument("--start", type=number(), help="leave out what is before this time of the log, s")
    parser.add_argument("--end", type=number(), help="leave out what is after this time of the log, s")
    parser.add_argument("--trust-units", action="store_true", help="do not judge the unit by the magnitude")
    parser.add_argument("--trust-still", action="store_true", help="do not look for movement")
    add_log_options(parser)


def read_standstill(args: argparse.Namespace) -> Standstill:
    """Read and check the one channel of --channel.

    Raises InputError: no such node, nothing in the span, wrong unit, moved.
    """
    recording, node = read_node(args.log, args.node, log_form(args, needed=()))
    return standstill(args, args.log, recording, node, args.channel)


def standstill(
    args: argparse.Namespace, log: Path, recording: Recording, node: str, channel: str, *, cut: bool = False
) -> Standstill:
    """One channel of a log that was read, checked. cut: movement is no error but told in `disturbed`."""
    return rest_channel(
        recording,
        node,
        channel,
        log=str(log),
        start=args.start,
        end=args.end,
        trust_units=args.trust_units,
        trust_still=args.trust_still,
        cut=cut,
    )


def read_node(log: Path, name: str | None, form: InputFormat = _AS_IT_IS) -> tuple[Recording, str]:
    """The log, and the node that is meant: the one named, or the only one. Raises InputError for another."""
    with progress_line() as show:
        recording = read_log(log, input_format=form, progress=show)
    check_nodes(recording, log)
    nodes = tuple(recording.nodes)
    node = name or (nodes[0] if len(nodes) == 1 else None)
    if node is None or node not in recording.nodes:
        asked = f"holds no node {node!r}" if node else "holds several nodes"
        raise InputError(f"{log}: {asked}; say --node with one of: {', '.join(nodes)}")
    return recording, node
