"""`hubodo filters`: compare filters of a gyro axis on a log, and give the settings of the best one."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from hubodo.atomic_files import write_atomically
from hubodo.errors import InputError
from hubodo.log.units import check_node_units
from hubodo.pages.drawing import save_figure
from hubodo.pages.page import render_page
from hubodo.sensors.filters.compare import compare_filters
from hubodo.sensors.filters.page import filter_figure, filter_sections, summarise_comparison
from hubodo.sensors.filters.result import FilterComparison
from hubodo.sensors.standstill_channel import IMU_CHANNELS
from hubodo.verbs.log_options import LOG_HELP, add_log_options, stated_input_format
from hubodo.verbs.numbers import bounded_number
from hubodo.verbs.standstill import add_page_options, read_node

EXAMPLE = "hubodo filters drive.mcap --node left --channel gz --reference wheels --report filters.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo filters`."""
    parser.add_argument(
        "log", type=Path, metavar="LOG", help=f"log of a drive, preferably with a standstill: {LOG_HELP}"
    )
    add_log_options(parser)
    parser.add_argument("--node", help="name of the node (default: the only one)")
    parser.add_argument(
        "--channel", choices=IMU_CHANNELS[:3], default="gz", help="gyro axis of the node (default gz)"
    )
    parser.add_argument(
        "--reference",
        metavar="TABLE[.COLUMN]",
        help="table of the log with the true rate, angle or wheel speed: wheels, table, reference.speed, or "
        "another node, such as frame.gz (default: filters are judged by the prediction of the next sample)",
    )
    parser.add_argument(
        "--rest",
        type=bounded_number(),
        nargs=2,
        action="append",
        default=[],
        metavar=("FROM", "TO"),
        help="span of a standstill, s of the log; repeatable (default: detected)",
    )
    parser.add_argument(
        "--start", type=bounded_number(), help="ignore samples before this time of the log, s"
    )
    parser.add_argument("--end", type=bounded_number(), help="ignore samples after this time of the log, s")
    add_page_options(parser, "write rate, error, bias and autocorrelation as .png, .svg or .pdf")


def run(args: argparse.Namespace) -> FilterComparison:
    """Compare the filters; write page and figure where asked.

    Returns
    -------
    FilterComparison
        The errors, delays and run times of all filters, and the settings of the best one.

    Raises
    ------
    InputError
        If node, channel or reference are missing, or the samples do not suffice.
    """
    form = stated_input_format(args, needed=())
    recording, node = read_node(args.log, args.node, form)
    source = f"{args.log}, node {node}"
    check_node_units(recording.nodes[node], source, form.si_factors())
    try:
        result = compare_filters(
            recording,
            node,
            args.channel,
            reference=args.reference,
            standstills=args.rest,
            start=args.start,
            end=args.end,
        )
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    result = replace(result, log=str(args.log), notes=(*recording.warnings, *result.notes))
    title = f"Filters of {result.name}"
    if args.report is not None:
        page = render_page(title, summarise_comparison(result), filter_sections(result))
        write_atomically(args.report, page)
    if args.figure is not None:
        save_figure(filter_figure(result, title), args.figure)
    return result
