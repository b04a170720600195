"""`hubodo calibrate wheels`: wheel radius, track width and mounting from a drive with known positions."""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from hubodo.atomic_files import write_atomically
from hubodo.calibration.file import (
    Calibration,
    find_node_serial,
    find_temperature_span,
    hash_source,
    read_calibration,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.fuse.latitude import add_latitude
from hubodo.fuse.projection import make_local_frame
from hubodo.fuse.wheel.calibration.calibrate import WheelPriors, calibrate_wheels
from hubodo.fuse.wheel.calibration.page import wheel_calibration_page
from hubodo.fuse.wheel.calibration.positions import Positions
from hubodo.fuse.wheel.calibration.result import WheelCalibration
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.node_screening import check_times
from hubodo.fuse.wheel_nodes import determine_log_ranges, extend_ranges
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.log.units import check_units
from hubodo.recording import Recording
from hubodo.vehicle import Vehicle, load_vehicle
from hubodo.verbs.log_options import (
    LOG_HELP,
    VEHICLE_HELP,
    add_log_options,
    stated_input_format,
    stored_vehicle,
)
from hubodo.verbs.numbers import bounded_number
from hubodo.verbs.outputs import add_calibration_output, add_force_option, add_units_option, html_path

HELP = "wheel radius, lever arm, spin-axis tilt, biases, scales and track, from a drive with truth or GNSS"
EXAMPLE = "hubodo calibrate wheels drive.mcap --vehicle vehicle.toml -o calibration.toml"

TRUTH_SIGMA = 0.1  # m
"""Upper bound of the white noise of a reference track; the calibration estimates the actual noise."""

GNSS_SIGMA = 3.0  # m
"""1σ of a GNSS fix whose receiver reports none."""

ANTENNA_SIGMA = 0.05  # m
"""1σ of an antenna position as measured by tape."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo calibrate wheels`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument(
        "--vehicle",
        type=Path,
        metavar="TOML",
        help=f"{VEHICLE_HELP}; default: the vehicle that the log carries",
    )
    add_calibration_output(parser)
    add_units_option(parser)
    for name, quantity in (
        ("radius", "a wheel's radius"),
        ("track", "the track width"),
        ("scale", "a gyro's scale"),
    ):
        parser.add_argument(
            f"--{name}-sigma",
            type=bounded_number(high=1.0, above=0.0),
            default=getattr(WheelPriors(), name),
            metavar="SHARE",
            help=f"prior of {quantity}, relative, 1σ (default %(default)s)",
        )
    parser.add_argument(
        "--report", type=html_path, metavar="HTML", help="write a page with held-out errors and parameters"
    )
    add_force_option(parser, "report")


def run(args: argparse.Namespace) -> WheelCalibration:
    """Calibrate wheels and nodes, and add the result to the calibration file.

    Returns
    -------
    WheelCalibration
        The calibration and the file that it was added to.

    Raises
    ------
    InputError
        If the log has neither truth nor GNSS, or no node of the vehicle file.
    """
    vehicle = stored_vehicle(args.log) if args.vehicle is None else load_vehicle(args.vehicle)
    recording = read_log(
        args.log, input_format=stated_input_format(args, vehicle, needed=(NODES_ROLE, "gnss"))
    )
    check_units(recording, vehicle.nodes, str(args.log))
    before = read_calibration(args.output) if args.output.exists() else Calibration()
    kind, positions = _positions(recording, vehicle, str(args.log))
    priors = WheelPriors(*(getattr(args, f"{name}_sigma") for name in ("radius", "track", "scale")))
    try:
        present = [name for name in vehicle.nodes if name in recording.nodes]
        ranges = determine_log_ranges(recording, vehicle, present)
        config = wheel_config(add_latitude(vehicle, recording), present, ranges=ranges)
    except ValueError as error:
        raise InputError(f"{args.log}: {error}; name the nodes in the vehicle file as in the log") from None
    check_times({name: recording.nodes[name] for name in config.nodes}, str(args.log))
    nodes = extend_ranges(recording, ranges).nodes
    calibration = calibrate_wheels(config, nodes, positions, priors)
    calibration = replace(
        calibration,
        warnings=recording.warnings + tuple(calibration.warnings),
        source=kind,
        output=str(args.output),
    )
    provenance: dict[str, Any] = {
        "method": f"wheel filter with {calibration.n_positions} positions ({kind})",
        "source_sha256": hash_source(args.log),
        "date": datetime.now(UTC).date().isoformat(),
    }
    updated = before
    for name in calibration.nodes:
        effects = calibration.effects(
            name, **provenance, temperature=find_temperature_span(recording.nodes[name])
        )
        updated = updated.with_node(name, effects, find_node_serial(recording.metadata, name))
    updated = updated.with_vehicle(calibration.vehicle_effects(**provenance))
    write_calibration(updated, args.output)
    if args.report is not None:
        write_atomically(args.report, wheel_calibration_page(calibration, args.log.name))
    return calibration


def _positions(recording: Recording, vehicle: Vehicle, log: str) -> tuple[str, Positions]:
    """Return the source of the positions, `truth` before `gnss`, and the positions themselves."""
    truth, gnss = recording.truth, recording.gnss
    antenna = None if vehicle.antenna is None else (*vehicle.antenna, ANTENNA_SIGMA)
    if truth is not None:
        t, x, y, sigma = truth.t, truth["x"], truth["y"], np.full(len(truth), TRUTH_SIGMA)
    elif gnss is not None and len(gnss) > 0:
        frame = make_local_frame(float(gnss["latitude_deg"][0]), float(gnss["longitude_deg"][0]))
        x, y = frame.to_local(gnss["latitude_deg"], gnss["longitude_deg"])
        t, sigma = gnss.t, gnss["sigma"] if "sigma" in gnss else np.full(len(gnss), GNSS_SIGMA)
    else:
        raise InputError(f"{log}: has neither truth nor GNSS; calibrate wheels needs known positions")
    valid = np.isfinite(x) & np.isfinite(y) & np.isfinite(sigma) & (sigma > 0)
    kind = "gnss" if truth is None else "truth"
    return kind, Positions(t[valid], x[valid], y[valid], sigma[valid], antenna)
