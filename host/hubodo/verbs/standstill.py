"""What `hubodo allan` and `hubodo warmup` share: channels of a node at rest, checked before they are used."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.file import node_serial
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.foreign import CHANNELS as CHANNELS
from hubodo.log.foreign import LogForm
from hubodo.progress import progress_line
from hubodo.recording import Recording, Table
from hubodo.sensors.at_rest import TemperatureStep, check_still, check_units, rest_of, temperature_step
from hubodo.verbs.log_options import LOG_HELP, add_log_options, check_nodes, log_form
from hubodo.verbs.numbers import number

FloatArray = NDArray[np.float64]

_AS_IT_IS = LogForm()


@dataclass(frozen=True)
class Standstill:
    """One channel at rest.

    t: (N,) s; values: (N,) rad/s or m/s²; temperature: (N,) degrees C or None; step: a temperature step, or
    None; serial: of the node, "" when the log does not tell; warnings: of the log; disturbed: (from, to) in
    s of what is to be cut out, where the verb can do without it.
    """

    node: str
    channel: str
    t: FloatArray
    values: FloatArray
    temperature: FloatArray | None
    step: TemperatureStep | None
    serial: str
    warnings: tuple[str, ...]
    disturbed: tuple[tuple[float, float], ...] = ()


def add_standstill_arguments(parser: argparse.ArgumentParser, channels: Sequence[str] = CHANNELS) -> None:
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
    table = recording.nodes[node]
    start = -np.inf if args.start is None else args.start
    end = np.inf if args.end is None else args.end
    span = slice(*np.searchsorted(table.t, [start, end]))
    measured = [name for name in CHANNELS if np.isfinite(table[name][span]).any()]
    if channel not in measured:
        raise InputError(
            f"{log}: node {node} has no {channel}; say --channel with {', '.join(measured) or 'another'}"
        )
    columns = np.column_stack([table[name][span] for name in measured])
    finite = np.isfinite(columns).all(axis=1)
    t, columns = table.t[span][finite], columns[finite]
    if len(t) < 2:
        raise InputError(
            f"{log}: node {node} has {len(t)} samples between --start and --end; choose another span"
        )
    gyro = columns[:, [k for k, name in enumerate(measured) if name[0] == "g"]]
    accel = columns[:, [k for k, name in enumerate(measured) if name[0] == "a"]]
    values = columns[:, measured.index(channel)].copy()
    moved: list[tuple[float, float]] = []
    try:
        if not args.trust_units:
            check_units(gyro, accel, float(np.median(np.diff(t))))
        if not args.trust_still and cut:
            moved = rest_of(t, columns, values)
        elif not args.trust_still:
            check_still(t, columns)
    except InputError as error:
        raise InputError(f"{log}, node {node}: {error}") from None
    temperature = temperature_of(table, np.flatnonzero(finite) + span.start)
    step = None if temperature is None else temperature_step(t, temperature)
    serial = node_serial(recording.metadata, node)
    return Standstill(node, channel, t, values, temperature, step, serial, recording.warnings, tuple(moved))


def read_node(log: Path, name: str | None, form: LogForm = _AS_IT_IS) -> tuple[Recording, str]:
    """The log, and the node that is meant: the one named, or the only one. Raises InputError for another."""
    with progress_line() as show:
        recording = read_log(log, form=form, progress=show)
    check_nodes(recording, log)
    nodes = tuple(recording.nodes)
    node = name or (nodes[0] if len(nodes) == 1 else None)
    if node is None or node not in recording.nodes:
        asked = f"holds no node {node!r}" if node else "holds several nodes"
        raise InputError(f"{log}: {asked}; say --node with one of: {', '.join(nodes)}")
    return recording, node


def temperature_of(table: Table, rows: NDArray[np.int64]) -> FloatArray | None:
    """(M,) degrees C of these rows, interpolated where a reading is missing; None without any."""
    if "temperature" not in table:
        return None
    values = table["temperature"][rows]
    known = np.isfinite(values)
    if not known.any():
        return None
    places = np.arange(len(values))
    made: FloatArray = np.interp(places, places[known], values[known])
    return made
