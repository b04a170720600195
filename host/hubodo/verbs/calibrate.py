"""`hubodo calibrate`: what a node or a wheel really is, from recordings made for that."""

from __future__ import annotations

import argparse

from hubodo.verbs import calibrate_imu, calibrate_wheels

EXAMPLE = calibrate_wheels.EXAMPLE

_KINDS = {"wheels": calibrate_wheels, "imu": calibrate_imu}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo calibrate wheels` and `hubodo calibrate imu`."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    for name, module in _KINDS.items():
        kind = kinds.add_parser(
            name, help=module.HELP, description=module.HELP, epilog=f"example: {module.EXAMPLE}"
        )
        module.add_arguments(kind)
        # Those of every verb, here behind the kind as well; without a default, to leave what stood before it.
        for option in ("--json", "--debug"):
            kind.add_argument(option, action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> calibrate_wheels.CalibratedWheels | calibrate_imu.CalibratedImu:
    """The calibration that was asked for."""
    if args.kind == "wheels":
        return calibrate_wheels.run(args)
    return calibrate_imu.run(args)
