"""`hubodo heading`: estimate the heading of a turntable or vehicle from one vertical gyro axis."""

from __future__ import annotations

import argparse
from pathlib import Path

from hubodo.atomic_files import atomic_files, write_atomically
from hubodo.calibration.file import read_calibration
from hubodo.errors import InputError
from hubodo.log.csv_table import write_table
from hubodo.log.units import check_node_units
from hubodo.pages.page import render_page
from hubodo.recording import Table
from hubodo.sensors.heading.estimate import HeadingOptions, effects_of_node, heading_from_recording
from hubodo.sensors.heading.page import heading_sections, save_heading_figure, summarise_heading
from hubodo.sensors.heading.prior import read_bias_noise
from hubodo.sensors.heading.result import HeadingResult
from hubodo.verbs.log_options import LOG_HELP, add_log_options, stated_input_format
from hubodo.verbs.numbers import bounded_number, non_negative_number
from hubodo.verbs.standstill import add_page_options, read_node

EXAMPLE = "hubodo heading drive.mcap --node frame --calibration calibration.toml -o heading.csv"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo heading`."""
    parser.add_argument(
        "log", type=Path, metavar="LOG", help=f"log that preferably begins with a standstill: {LOG_HELP}"
    )
    add_log_options(parser)
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument("--axis", choices=("x", "y", "z"), default="z", help="vertical gyro axis (default z)")
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="warm-up and scale of the node, as written by hubodo warmup and hubodo calibrate imu",
    )
    parser.add_argument(
        "--age", type=non_negative_number, help="time since power-on at the first sample, s (default 0)"
    )
    parser.add_argument(
        "--allan", type=Path, metavar="JSON", help="noise of the axis, as printed by hubodo allan --json"
    )
    parser.add_argument(
        "--rest",
        type=bounded_number(),
        nargs=2,
        action="append",
        metavar=("FROM", "TO"),
        help="span of a standstill, s of the log; repeatable (default: detected)",
    )
    parser.add_argument(
        "--scale-sigma",
        type=non_negative_number,
        help="1σ of the gyro scale, relative (default: from the calibration, else 0.01)",
    )
    parser.add_argument(
        "--lag",
        type=non_negative_number,
        help="delay of the gyro, s; it contributes to sigma (default: from the calibration, else 0.005)",
    )
    parser.add_argument(
        "--step",
        type=bounded_number(1e-3, 60.0),
        default=0.1,
        help="time step of the output, s (default 0.1)",
    )
    parser.add_argument("-o", "--output", type=Path, metavar="CSV", help="write t,heading,sigma")
    add_page_options(parser, "write the heading with its sigma as .png, .svg or .pdf", "output")


def run(args: argparse.Namespace) -> HeadingResult:
    """Estimate the heading and score it; write CSV, figure and page where asked.

    Returns
    -------
    HeadingResult
        Heading over time with sigma, and its score if the log holds a true heading.

    Raises
    ------
    InputError
        If the node or an axis is missing, the axis is not vertical, or neither standstill nor calibration
        gives the bias.
    """
    form = stated_input_format(args, needed=())
    recording, node = read_node(args.log, args.node, form)
    check_node_units(recording.nodes[node], f"{args.log}, node {node}", form.si_factors())
    try:
        options = HeadingOptions(
            axis=args.axis,
            effects={}
            if args.calibration is None
            else effects_of_node(read_calibration(args.calibration), node, str(args.calibration)),
            noise=None if args.allan is None else read_bias_noise(args.allan),
            age=args.age,
            standstills=args.rest or (),
            scale_sigma=args.scale_sigma,
            lag=args.lag,
            step=args.step,
        )
        output = None if args.output is None else str(args.output)
        result = heading_from_recording(recording, node, options, log=str(args.log), output=output)
    except InputError as error:
        raise InputError(f"{args.log}, node {node}, {args.axis}: {error}") from None
    if args.output is not None:
        track = result.track
        columns = {"t": track.t, "heading": track.heading + result.start, "sigma": track.sigma}
        with atomic_files(args.output) as (part,):
            write_table(part, Table(columns))
    title = f"Heading of {node} {args.axis}"
    if args.report is not None:
        write_atomically(args.report, render_page(title, summarise_heading(result), heading_sections(result)))
    if args.figure is not None:
        save_heading_figure(result, args.figure, title)
    return result
