"""`hubodo calibrate imu`: bias, scale and cross-axis terms of both sensors from nine or more static poses."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from hubodo.atomic_files import write_atomically
from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    find_node_serial,
    find_temperature_span,
    hash_source,
    read_calibration,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.pose_table import read_pose_table
from hubodo.pages.page import render_page
from hubodo.progress import progress_line
from hubodo.recording import Table
from hubodo.sensors.imu.node_imu import ImuOptions, calibrate_node_imu
from hubodo.sensors.imu.page import imu_sections, imu_verdict
from hubodo.sensors.imu.pose_means import DEFAULT_NODE, calibrate_pose_means
from hubodo.sensors.imu.result import ImuCalibration
from hubodo.verbs.log_options import LOG_HELP, add_log_options, channel_numbers, stated_input_format
from hubodo.verbs.numbers import latitude, positive_number
from hubodo.verbs.outputs import add_calibration_output, add_force_option, add_units_option, html_path
from hubodo.verbs.standstill import choose_node

HELP = "bias, scale and cross-axis terms of accelerometer and gyro, from nine or more static poses"
EXAMPLE = "hubodo calibrate imu poses.mcap --node left --gravity 9.81744 -o calibration.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo calibrate imu`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument(
        "--node",
        help="name of the node (default: the only one; with --means that of the calibration file, else imu)",
    )
    parser.add_argument(
        "--gravity", type=positive_number, default=9.80665, help="local gravity, m/s² (default 9.80665)"
    )
    parser.add_argument(
        "--latitude-deg", type=latitude, help="latitude; makes Earth rate the reference of precise gyros"
    )
    parser.add_argument(
        "--table-rate-deg-s",
        type=positive_number,
        help="constant rate of a rate table, as the reference of the gyro",
    )
    parser.add_argument(
        "--convention",
        choices=("symmetric", "x-first"),
        default="symmetric",
        help="accelerometer frame: symmetric cross-axis matrix, or x axis along sensor x (default symmetric)",
    )
    parser.add_argument(
        "--min-rest",
        type=positive_number,
        default=1.0,
        help="shortest standstill that counts as a pose, s (default 1)",
    )
    parser.add_argument(
        "--temperature-order",
        type=int,
        choices=range(4),
        help="order of the polynomials by which the biases follow the temperature, 0 for none (default: as "
        "held-out poses decide)",
    )
    parser.add_argument(
        "--means",
        action="store_true",
        help="LOG is a table with one row for each pose: means such as ax; sigma_ax, or std_ax and count; "
        "true values such as ref_ax",
    )
    parser.add_argument(
        "--mean-sigma",
        action="append",
        default=[],
        metavar="[CHANNEL=]SIGMA",
        help="1σ of the means of --means, m/s² and rad/s, of all channels or of one, such as accel=0.001 "
        "(default: from the table, else from the misfit of redundant poses); repeatable",
    )
    parser.add_argument(
        "--report", type=html_path, metavar="HTML", help="write a page with poses, parameters and residuals"
    )
    add_force_option(parser, "report")
    add_calibration_output(parser)
    add_units_option(parser)


def run(args: argparse.Namespace) -> ImuCalibration:
    """Calibrate both sensors of the node, and add the result to the calibration file.

    Returns
    -------
    ImuCalibration
        The calibration and the file that it was added to.

    Raises
    ------
    InputError
        If the node does not exist, its units are doubtful, or its poses do not suffice.
    """
    if args.mean_sigma and not args.means:
        raise InputError("--mean-sigma belongs to --means; the noise of a record is measured")
    before = read_calibration(args.output) if args.output.exists() else Calibration()
    if args.means:
        return _write(args, _calibrate_means(args, before), before, {}, None)
    with progress_line() as show:
        form = replace(
            stated_input_format(args, needed=()), advice_without_time="; --means reads means of poses"
        )
        recording = read_log(args.log, input_format=form, progress=show)
        show("detecting static poses and turns", 0.5)
        node = choose_node(recording, args.node, args.log)
        table = recording.nodes[node]
        calibration = calibrate_node_imu(table, node, str(args.log), imu_options(args))
    return _write(args, calibration, before, recording.metadata, table)


def _calibrate_means(args: argparse.Namespace, before: Calibration) -> ImuCalibration:
    """Return the calibration from a table of pose means."""
    if args.table_rate_deg_s is not None:
        raise InputError(
            "--table-rate-deg-s needs a record; with --means give the rates in columns such as ref_gz"
        )
    table = read_pose_table(args.log, stated_input_format(args, needed=()))
    sigmas = channel_numbers("--mean-sigma", args.mean_sigma)
    if any(sigma <= 0.0 for sigma in sigmas.values()):
        raise InputError("--mean-sigma must be above 0")
    return calibrate_pose_means(table, _node_of_means(args, before), str(args.log), imu_options(args), sigmas)


def _node_of_means(args: argparse.Namespace, before: Calibration) -> str:
    """Return the node of a table of means, which names none: that of --node, else of the calibration file."""
    if args.node is not None:
        return str(args.node)
    if len(before.nodes) > 1:
        raise InputError(
            f"{args.output}: holds several nodes; give --node with the one to calibrate: "
            f"{', '.join(before.nodes)}"
        )
    return next(iter(before.nodes), DEFAULT_NODE)


def _write(
    args: argparse.Namespace,
    calibration: ImuCalibration,
    before: Calibration,
    metadata: Mapping[str, str],
    table: Table | None,
) -> ImuCalibration:
    """Add the calibration to its file, write the page, and return the result with the path of the file."""
    result = replace(calibration, output=str(args.output))
    effects = calibrated_effects(result, table, hash_source(args.log))
    serial = find_node_serial(metadata, result.node)
    write_calibration(before.with_node(result.node, effects, serial), args.output)
    if args.report is not None:
        page = render_page(f"Calibration of {result.node}", imu_verdict(result), imu_sections(result))
        write_atomically(args.report, page)
    return result


def imu_options(args: argparse.Namespace) -> ImuOptions:
    """Return the options of the calibration."""
    return ImuOptions(
        args.gravity,
        args.latitude_deg,
        args.table_rate_deg_s,
        args.convention,
        args.min_rest,
        args.temperature_order,
    )


def calibrated_effects(
    result: ImuCalibration, table: Table | None, source_sha256: str
) -> dict[str, CalibratedEffect]:
    """Return the calibration as effects for the calibration file, with their provenance."""
    date = datetime.now(UTC).date().isoformat()
    span = None if table is None else find_temperature_span(table)
    methods = {"accel": result.notes[0], "gyro": "" if result.gyro is None else result.gyro.method}
    return {
        name: CalibratedEffect(parameters, methods[name.partition("_")[0]], source_sha256, date, span)
        for name, parameters in result.effect_parameters().items()
    }
