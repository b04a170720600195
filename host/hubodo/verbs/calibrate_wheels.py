"""`hubodo calibrate wheels`: wheels, track and mounting of the nodes from a drive with known positions."""

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
from hubodo.fuse.projection import local_frame
from hubodo.fuse.wheel.calibration.calibrate import WheelCalibration, WheelPriors, calibrate_wheels
from hubodo.fuse.wheel.calibration.learnt_parameters import quantities_as_json
from hubodo.fuse.wheel.calibration.positions import Positions
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.node_times import check_times
from hubodo.fuse.wheels import located, log_ranges
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.log.units import check_units
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle, load_vehicle
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.verbs.numbers import number

HELP = "wheel radius, lever arm, spin-axis tilt, biases, scales and track, from a drive with truth or GNSS"
EXAMPLE = "hubodo calibrate wheels drive.mcap --vehicle vehicle.toml -o calibration.toml"

TRUTH_SIGMA = 0.1
"""m; what is called a truth is no worse from one row to the next. How good it is, it shows."""

GNSS_SIGMA = 3.0
"""m; of a receiver that does not say."""

ANTENNA_SIGMA = 0.05
"""m; how well a tape measure knows where an antenna is."""


@dataclass(frozen=True)
class CalibratedWheels:
    """What was found, and where it was written. positions: `truth` or `gnss`."""

    output: str
    positions: str
    result: WheelCalibration

    def as_json(self) -> dict[str, Any]:
        """One object; units of the model file."""
        found = self.result
        return {
            "output": self.output,
            "positions": self.positions,
            "fixes": found.n_positions,
            "jumps": found.n_jumps,
            "position_error": {"random": found.white_sigma, "slow": found.slow_sigma},
            "antenna": {name: asdict(q) for name, q in zip("xy", found.antenna, strict=True)},
            "rms_before": found.rms,
            "held_out": asdict(found.held_out),
            "nodes": {name: quantities_as_json(effects) for name, effects in found.nodes.items()},
            "vehicle": quantities_as_json(found.vehicle),
            "unseen": list(found.not_observable),
            "warnings": list(found.warnings),
        }

    def render(self, console: Console) -> None:
        """A table of the parameters, then what stayed unseen."""
        table = TextTable("of", "effect", "parameter", "value", "1 sigma", title=f"→ {self.output}")
        for name, effects in (*self.result.nodes.items(), ("vehicle", self.result.vehicle)):
            for effect, parameters in effects.items():
                for parameter, q in parameters.items():
                    table.add_row(name, effect, parameter, f"{q.value:+.6g}", f"{q.sigma:.2g}")
        console.print(table)
        for line in _words(self.result, self.positions):
            console.print(line, highlight=False, soft_wrap=True)
        for line in self.result.not_observable:
            console.print(f"not seen: {line}", highlight=False, markup=False, soft_wrap=True)
        for line in self.result.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo calibrate wheels`."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_log_options(parser)
    parser.add_argument("--vehicle", type=Path, required=True, metavar="TOML", help="[vehicle] and [nodes.*]")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="TOML", help="calibration file; added to"
    )
    for name, of in (
        ("radius", "a wheel's radius"),
        ("track", "the track width"),
        ("scale", "a gyro's scale"),
    ):
        parser.add_argument(
            f"--{name}-sigma",
            type=number(high=1.0, above=0.0),
            default=getattr(WheelPriors(), name),
            metavar="SHARE",
            help=f"by which {of} may be off before the drive, 1 sigma (default %(default)s)",
        )


def run(args: argparse.Namespace) -> CalibratedWheels:
    """Read, calibrate, add to the calibration file."""
    vehicle = load_vehicle(args.vehicle)
    recording = read_log(args.log, input_format=log_form(args, vehicle, needed=(NODES_ROLE, "gnss")))
    check_units(recording, vehicle.nodes, str(args.log))
    before = read_calibration(args.output) if args.output.exists() else Calibration()
    kind, positions = _positions(recording, vehicle, str(args.log))
    priors = WheelPriors(*(getattr(args, f"{name}_sigma") for name in ("radius", "track", "scale")))
    try:
        there = [name for name in vehicle.nodes if name in recording.nodes]
        config = wheel_config(
            located(vehicle, recording), there, ranges=log_ranges(recording, vehicle, there)
        )
    except ValueError as error:
        raise InputError(f"{args.log}: {error}; name the nodes in the vehicle file as in the log") from None
    check_times({name: recording.nodes[name] for name in config.nodes}, str(args.log))
    found = calibrate_wheels(config, recording.nodes, positions, priors)
    found = replace(found, warnings=recording.warnings + tuple(found.warnings))
    provenance: dict[str, Any] = {
        "method": f"wheel filter with {found.n_positions} positions ({kind})",
        "source_sha256": hash_source(args.log),
        "date": datetime.now(UTC).date().isoformat(),
    }
    made = before
    for name in found.nodes:
        effects = found.effects(name, **provenance, temperature=_span(recording.nodes[name]))
        made = made.with_node(name, effects, find_node_serial(recording.metadata, name))
    made = made.with_vehicle(found.vehicle_effects(**provenance))
    write_calibration(made, args.output)
    return CalibratedWheels(str(args.output), kind, found)


def _positions(recording: Recording, vehicle: Vehicle, log: str) -> tuple[str, Positions]:
    """Truth where there is one, else GNSS: its name, and where it says that the vehicle was."""
    truth, gnss = recording.truth, recording.gnss
    antenna = None if vehicle.antenna is None else (*vehicle.antenna, ANTENNA_SIGMA)
    if truth is not None:
        t, x, y, sigma = truth.t, truth["x"], truth["y"], np.full(len(truth), TRUTH_SIGMA)
    elif gnss is not None and len(gnss) > 0:
        frame = local_frame(float(gnss["latitude_deg"][0]), float(gnss["longitude_deg"][0]))
        x, y = frame.to_local(gnss["latitude_deg"], gnss["longitude_deg"])
        t, sigma = gnss.t, gnss["sigma"] if "sigma" in gnss else np.full(len(gnss), GNSS_SIGMA)
    else:
        raise InputError(f"{log}: has neither truth nor GNSS; calibrate wheels needs to know where it was")
    sound = np.isfinite(x) & np.isfinite(y) & np.isfinite(sigma) & (sigma > 0)
    kind = "gnss" if truth is None else "truth"
    return kind, Positions(t[sound], x[sound], y[sound], sigma[sound], antenna)


def _words(found: WheelCalibration, positions: str) -> Iterator[str]:
    """What people want to know beside the table."""
    yield (
        f"{found.n_positions} positions ({positions}), off by {found.white_sigma:.2g} m at random and "
        f"{found.slow_sigma:.2g} m slowly; before calibration the track was {found.rms:.2f} m rms from them"
    )
    if found.n_jumps:
        yield f"the positions jumped {found.n_jumps} times; each began a new slow error"
    x, y = found.antenna
    yield f"antenna {x.value:+.2f} ± {x.sigma:.2f} m forward, {y.value:+.2f} ± {y.sigma:.2f} m to the left"
    judged = found.held_out
    if judged.stretches:
        yield (f"held out: {judged.stretches} stretches, calibrated on the others each: {judged.description}")
    else:
        yield "held out: the drive is too short to leave stretches out; whether it helps is not known"


def _span(table: Table) -> tuple[float, float] | None:
    if "temperature" not in table:
        return None
    known = table["temperature"][np.isfinite(table["temperature"])]
    return (float(known.min()), float(known.max())) if len(known) else None
