"""`hubodo calibrate`: calibrate wheels from a drive, or the sensors of a node from poses or a rate table."""

from __future__ import annotations

import argparse

from hubodo.fuse.wheel.calibration.result import WheelCalibration
from hubodo.sensors.imu.pose_plan import PosePlan
from hubodo.sensors.imu.result import ImuCalibration
from hubodo.sensors.rate_table.result import RateCalibration
from hubodo.verbs import calibrate_imu, calibrate_plan, calibrate_rate, calibrate_wheels

EXAMPLE = calibrate_wheels.EXAMPLE

_KINDS = {"wheels": calibrate_wheels, "imu": calibrate_imu, "rate": calibrate_rate, "plan": calibrate_plan}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of each kind of calibration."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    for name, module in _KINDS.items():
        kind = kinds.add_parser(
            name, help=module.HELP, description=module.HELP, epilog=f"example: {module.EXAMPLE}"
        )
        module.add_arguments(kind)
        # Common options are accepted after KIND too; SUPPRESS keeps a value that was given before KIND.
        for option in ("--json", "--debug"):
            kind.add_argument(option, action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> WheelCalibration | ImuCalibration | RateCalibration | PosePlan:
    """Run the requested kind of calibration.

    Returns
    -------
    WheelCalibration, ImuCalibration, RateCalibration or PosePlan
        The calibration and the file that it was added to, or the plan of one.

    Raises
    ------
    InputError
        If the log does not hold what the calibration needs.
    """
    if args.kind == "wheels":
        return calibrate_wheels.run(args)
    if args.kind == "plan":
        return calibrate_plan.run(args)
    return calibrate_imu.run(args) if args.kind == "imu" else calibrate_rate.run(args)
