"""Checks of the arguments of `hubodo gap` for wrong order and wrong kind."""

from __future__ import annotations

import argparse
from pathlib import Path

from hubodo.errors import ConfigError, InputError
from hubodo.toml_file import load_toml


def check_argument_order(args: argparse.Namespace) -> None:
    """Raise InputError for a log in place of a model, or a model or vehicle in place of the other."""
    for option, path in (("--before", args.before), ("--after", args.after)):
        if path is not None and _is_toml(path):
            raise InputError(
                f"{option} {path}: a log is due here, and this is a TOML file; MODEL comes first"
            )
    if args.log is not None and _is_toml(args.log) and not _is_toml(args.model):
        raise InputError(f"{args.log} is no log: MODEL comes before LOG: hubodo gap {args.log} {args.model}")
    if args.log is not None and _is_toml(args.log):
        raise InputError(f"{args.log}: a log is due here, and this is a TOML file like {args.model}")
    if args.vehicle is not None and args.before is None and args.log is None and _is_toml(args.model):
        raise InputError(f"{args.model}: a log is due here, and this is a TOML file like {args.vehicle}")
    is_model_due = args.vehicle is None or args.before is not None
    if args.model is not None and is_model_due and _describes_vehicle_only(args.model):
        logs = f"--before {args.before} --after {args.after}" if args.before else str(args.log)
        raise InputError(
            f"{args.model}: describes a vehicle, not a model ([imu] is missing): "
            f"hubodo gap --vehicle {args.model} {logs}"
        )


def _is_toml(path: Path) -> bool:
    return path.suffix.lower() == ".toml"


def _describes_vehicle_only(path: Path) -> bool:
    """Return True for a TOML file with a vehicle and without sensor noise."""
    try:
        table = load_toml(path)
    except ConfigError:
        return False
    return "vehicle" in table and "imu" not in table
