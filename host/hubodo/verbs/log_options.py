"""The options by which every verb that reads a log is told what a foreign file does not say itself."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from hubodo.errors import InputError
from hubodo.log.foreign import LogForm
from hubodo.log.units import doubtful
from hubodo.recording import Recording, Table
from hubodo.verbs.numbers import positive

LOG_HELP = "MCAP, rosbag or rosbag2, CSV folder, or one file of numbers (CSV, MATLAB, HDF5, numpy)"


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """--rate, --unit, --columns, --variable."""
    group = parser.add_argument_group("files that do not say it themselves")
    group.add_argument(
        "--rate", type=positive, metavar="HZ", help="samples per second, where there are no times"
    )
    group.add_argument(
        "--unit",
        action="append",
        default=[],
        metavar="UNIT",
        help="rad/s, deg/s, mdeg/s, deg/h, m/s^2, g, mg; of a count: '0.00875 deg/s'; once for each sensor",
    )
    group.add_argument(
        "--columns",
        metavar="NAMES",
        help="what each column is, as in t,gx,gy,gz,-,temperature",
    )
    group.add_argument("--variable", metavar="NAMES", help="arrays of a MATLAB, HDF5 or numpy file")


def log_form(args: argparse.Namespace) -> LogForm:
    """What the options say. Raises InputError for two units of one sensor."""
    columns = () if args.columns is None else tuple(name.strip() for name in args.columns.split(","))
    channel = getattr(args, "channel", None) or "gz"
    form = LogForm(args.rate, tuple(args.unit), columns, args.variable, channel)
    if len(form.factors()) < len(form.units):
        raise InputError(
            f"--unit {', '.join(form.units)}: at most one for the gyro and one for the accelerometer"
        )
    return form


def check_node_units(table: Table, where: str) -> None:
    """Raises InputError for a node whose numbers, in whatever motion, look to be in other units than SI."""
    words = doubtful(table.gyro, table.accel)
    if words is not None:
        raise InputError(f"{where}: {words}")


def check_units(recording: Recording, nodes: Iterable[str], log: str) -> None:
    """The same of those of these nodes that a recording has."""
    for node in nodes:
        if node in recording.nodes:
            check_node_units(recording.nodes[node], f"{log}, node {node}")
