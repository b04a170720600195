"""`hubodo calibrate rate`: scale, asymmetry, nonlinearity and hysteresis of a gyro axis on a rate table."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    NodeCalibration,
    find_node_serial,
    find_temperature_span,
    hash_source,
    read_calibration,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.rate_file import read_rate_file
from hubodo.log.units import si_factor
from hubodo.progress import progress_line
from hubodo.sensors.rate_table.calibrate import RateOptions, calibrate_node_rate
from hubodo.sensors.rate_table.result import RateCalibration
from hubodo.verbs.log_options import LOG_HELP, add_log_options, stated_input_format
from hubodo.verbs.numbers import latitude, non_negative_number, positive_number
from hubodo.verbs.outputs import add_calibration_output, add_units_option
from hubodo.verbs.standstill import choose_node

HELP = "scale, asymmetry, nonlinearity and hysteresis of a gyro axis, from the rates of a rate table"
EXAMPLE = "hubodo calibrate rate table.mcap --node left --axis z --table rates.csv -o calibration.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo calibrate rate`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument(
        "--axis", choices=("x", "y", "z"), default="z", help="gyro axis along that of the table (default z)"
    )
    parser.add_argument(
        "--table",
        type=Path,
        metavar="CSV",
        help="rates of the table over time: columns t and rate_deg_s (a column rate is in rad/s)",
    )
    parser.add_argument(
        "--rates-deg-s",
        type=_rates,
        metavar="RATES",
        help="rates in order without their times, such as --rates-deg-s=0,50,100,50,0,-50,-100,-50,0",
    )
    parser.add_argument(
        "--settle",
        type=non_negative_number,
        default=1.0,
        help="time cut off at both ends of each rate, s (default 1)",
    )
    parser.add_argument(
        "--min-plateau",
        type=positive_number,
        default=3.0,
        help="shortest steady rate that counts with --rates-deg-s, s (default 3)",
    )
    parser.add_argument(
        "--full-scale-deg-s", type=positive_number, help="full scale of the gyro (default: the largest rate)"
    )
    parser.add_argument(
        "--latitude-deg",
        type=latitude,
        help="latitude of a table with a vertical axis, upwards for positive rates; takes Earth rate "
        "off the bias",
    )
    add_calibration_output(parser)
    add_units_option(parser)


def run(args: argparse.Namespace) -> RateCalibration:
    """Calibrate one gyro axis of the node, and add bias and scale to the calibration file.

    Returns
    -------
    RateCalibration
        The figures with their sigmas.

    Raises
    ------
    InputError
        If the node does not exist, its units are doubtful, or it does not follow the table.
    CalibrationError
        If the rates do not suffice.
    """
    if (args.table is None) == (args.rates_deg_s is None):
        raise InputError("the rates of the table are needed: give either --table CSV or --rates-deg-s RATES")
    before = read_calibration(args.output) if args.output.exists() else Calibration()
    options = RateOptions(
        [math.radians(rate) for rate in args.rates_deg_s or ()],
        None if args.table is None else read_rate_file(args.table),
        args.settle,
        args.min_plateau,
        None if args.full_scale_deg_s is None else math.radians(args.full_scale_deg_s),
        None if args.latitude_deg is None else math.radians(args.latitude_deg),
    )
    with progress_line() as show:
        recording = read_log(args.log, input_format=stated_input_format(args, needed=()), progress=show)
        node = choose_node(recording, args.node, args.log)
        table = recording.nodes[node]
        stated_units = [si_factor(unit)[0] for unit in args.unit]
        result = calibrate_node_rate(table, node, args.axis, str(args.log), options, stated_units)
    stored = before.nodes.get(node, NodeCalibration()).effects
    method = f"rate table, {len(result.plateaus.rate)} plateaus of {len(result.fit.rates)} rates"
    digest, date = hash_source(args.log), datetime.now(UTC).date().isoformat()
    effects = {}
    for name, parameters in result.effect_parameters().items():
        other_axes = stored[name].parameters if name in stored else {}
        effects[name] = CalibratedEffect(
            {**other_axes, **parameters}, method, digest, date, find_temperature_span(table)
        )
    serial = find_node_serial(recording.metadata, node)
    write_calibration(before.with_node(node, effects, serial), args.output)
    return replace(result, output=str(args.output))


def _rates(text: str) -> list[float]:
    """Convert a list of numbers with commas; argparse reports another text as a wrong argument."""
    rates = [float(part) for part in text.split(",")]
    if not all(map(math.isfinite, rates)):
        raise ValueError(text)
    return rates
