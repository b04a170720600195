"""`hubodo calibrate plan`: plan the poses of `calibrate imu` for the noise of an accelerometer."""

from __future__ import annotations

import argparse
from pathlib import Path

from hubodo.atomic_files import write_atomically
from hubodo.errors import InputError
from hubodo.pages.page import render_page
from hubodo.sensors.imu.pose_plan import (
    PLANNED_BIAS_SIGMA,
    PLANNED_TURN_S,
    PosePlan,
    plan_poses,
    read_accelerometer_noise,
)
from hubodo.sensors.north.drift import DriftNoise
from hubodo.verbs.numbers import non_negative_number, positive_number
from hubodo.verbs.outputs import add_force_option, add_units_option, html_path

HELP = "plan the poses of an accelerometer calibration: which, how long, and to what sigma"
EXAMPLE = "hubodo calibrate plan --noise-density 0.002 --bias-sigma 0.005"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo calibrate plan`."""
    parser.add_argument(
        "--allan", type=Path, metavar="JSON", help="noise of one accelerometer axis: hubodo allan --json"
    )
    parser.add_argument(
        "--noise-density", type=positive_number, help="noise of the accelerometers, m/s²/√Hz, without --allan"
    )
    parser.add_argument(
        "--bias-instability",
        type=non_negative_number,
        help="bias instability of the accelerometers, m/s², beside --noise-density (default 0)",
    )
    parser.add_argument(
        "--bias-sigma",
        type=positive_number,
        default=PLANNED_BIAS_SIGMA,
        help="requested sigma of the biases, m/s² (default 0.005)",
    )
    parser.add_argument(
        "--turn",
        type=non_negative_number,
        default=PLANNED_TURN_S,
        help="time from pose to pose, s (default 5)",
    )
    parser.add_argument("--report", type=html_path, metavar="HTML", help="write the plan as a page")
    add_units_option(parser)
    add_force_option(parser, "report")


def run(args: argparse.Namespace) -> PosePlan:
    """Plan with the noise of --allan or --noise-density.

    Returns
    -------
    PosePlan
        The shortest programme for each number of poses.

    Raises
    ------
    InputError
        Without a noise, or for the Allan deviation of a gyro.
    """
    if (args.allan is None) == (args.noise_density is None):
        raise InputError("give the noise: --allan JSON of an accelerometer axis, or --noise-density")
    if args.allan is None:
        noise = DriftNoise(args.noise_density, args.bias_instability or 0.0, 0.0)
    elif args.bias_instability is not None:
        raise InputError("--bias-instability belongs to --noise-density; --allan has its own")
    else:
        noise = read_accelerometer_noise(args.allan)
    plan = plan_poses(noise, args.bias_sigma, args.turn)
    if args.report is not None:
        summary = plan.summary()
        page = render_page("Poses of a calibration", f"{summary[0].upper()}{summary[1:]}.", plan.sections())
        write_atomically(args.report, page)
    return plan
