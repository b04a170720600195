"""`hubodo calibrate wheels`: wheel radius, track width and mounting from a drive with known positions."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from hubodo.calibration.file import (
    Calibration,
    find_node_serial,
    hash_source,
    read_calibration,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.fuse.projection import make_local_frame
from hubodo.fuse.wheel.calibration.calibrate import WheelCalibration, WheelPriors, calibrate_wheels
from hubodo.fuse.wheel.calibration.learnt_parameters import quantities_as_json
from hubodo.fuse.wheel.calibration.positions import Positions
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.node_screening import check_times
from hubodo.fuse.wheel_odometry import add_latitude, determine_log_ranges
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.log.units import check_units
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle, load_vehicle
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.verbs.numbers import bounded_number

HELP = "wheel radius, lever arm, spin-axis tilt, biases, scales and track, from a drive with truth or GNSS"
EXAMPLE = "hubodo calibrate wheels drive.mcap --vehicle vehicle.toml -o calibration.toml"

TRUTH_SIGMA = 0.1  # m
"""Upper bound of the white noise of a reference track; the calibration estimates the actual noise."""

GNSS_SIGMA = 3.0  # m
"""1σ of a GNSS fix whose receiver reports none."""

ANTENNA_SIGMA = 0.05  # m
"""1σ of an antenna position as measured by tape."""


@dataclass(frozen=True)
class WheelCalibrationResult:
    """The wheel calibration, and the file that it was added to.

    Attributes
    ----------
    output
        Path of the calibration file.
    positions
        Source of the positions: `truth` or `gnss`.
    result
        Estimated effects, residuals and the held-out check.
    """

    output: str
    positions: str
    result: WheelCalibration

    def as_json(self) -> dict[str, Any]:
        """Return the calibration as one JSON object, in the units of the model file."""
        calibration = self.result
        return {
            "output": self.output,
            "positions": self.positions,
            "fixes": calibration.n_positions,
            "jumps": calibration.n_jumps,
            "position_error": {"random": calibration.white_sigma, "slow": calibration.slow_sigma},
            "antenna": {name: asdict(q) for name, q in zip("xy", calibration.antenna, strict=True)},
            "rms_before": calibration.rms,
            "held_out": asdict(calibration.held_out),
            "nodes": {name: quantities_as_json(effects) for name, effects in calibration.nodes.items()},
            "vehicle": quantities_as_json(calibration.vehicle),
            "unseen": list(calibration.not_observable),
            "warnings": list(calibration.warnings),
        }

    def render(self, console: Console) -> None:
        """Print the parameters, the residuals, then the parameters that were not observable."""
        table = TextTable("scope", "effect", "parameter", "value", "1σ", title=f"→ {self.output}")
        for name, effects in (*self.result.nodes.items(), ("vehicle", self.result.vehicle)):
            for effect, parameters in effects.items():
                for parameter, q in parameters.items():
                    table.add_row(name, effect, parameter, f"{q.value:+.6g}", f"{q.sigma:.2g}")
        console.print(table)
        for line in _summary_lines(self.result, self.positions):
            console.print(line, highlight=False, soft_wrap=True)
        for line in self.result.not_observable:
            console.print(f"not observable: {line}", highlight=False, markup=False, soft_wrap=True)
        for line in self.result.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo calibrate wheels`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument("--vehicle", type=Path, required=True, metavar="TOML", help="[vehicle] and [nodes.*]")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="TOML",
        help="calibration file to create or extend",
    )
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


def run(args: argparse.Namespace) -> WheelCalibrationResult:
    """Calibrate wheels and nodes, and add the result to the calibration file.

    Returns
    -------
    WheelCalibrationResult
        The calibration and the file that it was added to.

    Raises
    ------
    InputError
        If the log has neither truth nor GNSS, or no node of the vehicle file.
    """
    vehicle = load_vehicle(args.vehicle)
    recording = read_log(args.log, input_format=log_form(args, vehicle, needed=(NODES_ROLE, "gnss")))
    check_units(recording, vehicle.nodes, str(args.log))
    before = read_calibration(args.output) if args.output.exists() else Calibration()
    kind, positions = _positions(recording, vehicle, str(args.log))
    priors = WheelPriors(*(getattr(args, f"{name}_sigma") for name in ("radius", "track", "scale")))
    try:
        present = [name for name in vehicle.nodes if name in recording.nodes]
        config = wheel_config(
            add_latitude(vehicle, recording),
            present,
            ranges=determine_log_ranges(recording, vehicle, present),
        )
    except ValueError as error:
        raise InputError(f"{args.log}: {error}; name the nodes in the vehicle file as in the log") from None
    check_times({name: recording.nodes[name] for name in config.nodes}, str(args.log))
    calibration = calibrate_wheels(config, recording.nodes, positions, priors)
    calibration = replace(calibration, warnings=recording.warnings + tuple(calibration.warnings))
    provenance: dict[str, Any] = {
        "method": f"wheel filter with {calibration.n_positions} positions ({kind})",
        "source_sha256": hash_source(args.log),
        "date": datetime.now(UTC).date().isoformat(),
    }
    updated = before
    for name in calibration.nodes:
        effects = calibration.effects(
            name, **provenance, temperature=_temperature_span(recording.nodes[name])
        )
        updated = updated.with_node(name, effects, find_node_serial(recording.metadata, name))
    updated = updated.with_vehicle(calibration.vehicle_effects(**provenance))
    write_calibration(updated, args.output)
    return WheelCalibrationResult(str(args.output), kind, calibration)


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


def _summary_lines(calibration: WheelCalibration, positions: str) -> Iterator[str]:
    """Yield lines about residuals, antenna and the held-out check."""
    yield (
        f"{calibration.n_positions} positions ({positions}) with {calibration.white_sigma:.2g} m of white "
        f"noise and {calibration.slow_sigma:.2g} m of slow error (1σ); before calibration the track "
        f"deviated by {calibration.rms:.2f} m rms"
    )
    if calibration.n_jumps:
        yield f"the positions jumped {calibration.n_jumps} times; the slow error was reset at each jump"
    x, y = calibration.antenna
    yield f"antenna {x.value:+.2f} ± {x.sigma:.2f} m forward, {y.value:+.2f} ± {y.sigma:.2f} m to the left"
    check = calibration.held_out
    if check.stretches:
        yield (f"held out: {check.stretches} segments, each predicted from the others: {check.description}")
    else:
        yield "held out: the drive is too short for a held-out check; the gain is not verified"


def _temperature_span(table: Table) -> tuple[float, float] | None:
    if "temperature" not in table:
        return None
    known = table["temperature"][np.isfinite(table["temperature"])]
    return (float(known.min()), float(known.max())) if len(known) else None
