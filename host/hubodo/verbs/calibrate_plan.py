"""`hubodo calibrate plan`: plan the poses of `calibrate imu` for the noise of an accelerometer."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from hubodo.errors import InputError
from hubodo.sensors.imu.pose_plan import PosePlan, plan_poses
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.plan import read_drift_noise
from hubodo.verbs.numbers import non_negative_number, positive_number
from hubodo.verbs.outputs import add_units_option

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
        default=0.005,
        help="requested sigma of the biases, m/s² (default 0.005)",
    )
    parser.add_argument(
        "--turn", type=non_negative_number, default=5.0, help="time from pose to pose, s (default 5)"
    )
    add_units_option(parser)


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
        noise = read_drift_noise(args.allan)
        channel = str(json.loads(args.allan.read_text("utf-8")).get("channel", ""))
        if not channel.startswith("a"):
            raise InputError(f"{args.allan}: is of {channel or 'no channel'}; give that of ax, ay or az")
    return plan_poses(noise, args.bias_sigma, args.turn)
