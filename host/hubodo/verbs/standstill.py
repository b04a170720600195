"""What `hubodo allan` and `hubodo warmup` share: one channel of a node at rest, checked before it is used."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hubodo.calibration.file import node_serial
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.progress import progress_line
from hubodo.recording import Recording, Table
from hubodo.sensors.at_rest import TemperatureStep, check_still, check_units, temperature_step

FloatArray = NDArray[np.float64]

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")


@dataclass(frozen=True)
class Standstill:
    """One channel at rest.

    t: (N,) s; values: (N,) rad/s or m/s²; temperature: (N,) degrees C or None; step: a temperature step, or
    None; serial: of the node, "" when the log does not tell; warnings: of the log.
    """

    node: str
    channel: str
    t: FloatArray
    values: FloatArray
    temperature: FloatArray | None
    step: TemperatureStep | None
    serial: str
    warnings: tuple[str, ...]


def add_standstill_arguments(parser: argparse.ArgumentParser, channels: tuple[str, ...] = CHANNELS) -> None:
    """LOG, --node, --channel, --start, --end, --trust-units, --trust-still."""
    parser.add_argument(
        "log", type=Path, metavar="LOG", help="MCAP recording or CSV folder of a sensor at rest"
    )
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument("--channel", choices=channels, default="gz", help="column of the node (default gz)")
    parser.add_argument("--start", type=float, help="leave out what is before this time of the log, s")
    parser.add_argument("--end", type=float, help="leave out what is after this time of the log, s")
    parser.add_argument("--trust-units", action="store_true", help="do not judge the unit by the magnitude")
    parser.add_argument("--trust-still", action="store_true", help="do not look for movement")


def read_standstill(args: argparse.Namespace) -> Standstill:
    """Read and check. Raises InputError: no such node, nothing in the span, wrong unit, moved."""
    recording, node = read_node(args.log, args.node)
    table = recording.nodes[node]
    start = -np.inf if args.start is None else args.start
    end = np.inf if args.end is None else args.end
    span = slice(*np.searchsorted(table.t, [start, end]))
    t = table.t[span]
    if len(t) < 2:
        raise InputError(
            f"{args.log}: node {node} has {len(t)} samples between --start and --end; choose another span"
        )
    columns = np.column_stack([table[name][span] for name in CHANNELS])
    finite = np.isfinite(columns).all(axis=1)
    t, columns = t[finite], columns[finite]
    try:
        if not args.trust_units:
            check_units(columns[:, :3], columns[:, 3:])
        if not args.trust_still:
            check_still(t, columns)
    except InputError as error:
        raise InputError(f"{args.log}, node {node}: {error}") from None
    temperature = temperature_of(table, np.flatnonzero(finite) + span.start)
    step = None if temperature is None else temperature_step(t, temperature)
    values = columns[:, CHANNELS.index(args.channel)].copy()
    serial = node_serial(recording.metadata, node)
    return Standstill(node, args.channel, t, values, temperature, step, serial, recording.warnings)


def read_node(log: Path, name: str | None) -> tuple[Recording, str]:
    """The log, and the node that is meant: the one named, or the only one. Raises InputError for another."""
    with progress_line() as show:
        recording = read_log(log, progress=show)
    nodes = tuple(recording.nodes)
    node = name or (nodes[0] if len(nodes) == 1 else None)
    if node is None or node not in recording.nodes:
        asked = f"holds no node {node!r}" if node else "holds several nodes"
        raise InputError(f"{log}: {asked}; say --node with one of: {', '.join(nodes) or 'none'}")
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
