"""`hubodo calibrate wheels`: wheels, track and mounting of the nodes from a drive with known positions."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from hubodo.arrays import Array
from hubodo.calibration.file import (
    Calibration,
    Quantity,
    node_serial,
    read_calibration,
    source_hash,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.fuse.projection import local_frame
from hubodo.fuse.wheel.calibrate import WheelCalibration, calibrate_wheels
from hubodo.fuse.wheel.config import wheel_config
from hubodo.log.csv_folder import read_folder
from hubodo.log.mcap import read_recording
from hubodo.recording import Recording, Table
from hubodo.vehicle import load_vehicle

HELP = "wheel radius, lever arm, spin-axis tilt, biases, scales and track, from a drive with truth or GNSS"
EXAMPLE = "hubodo calibrate wheels drive.mcap --vehicle vehicle.toml -o calibration.toml"

TRUTH_SIGMA = 0.01
GNSS_SIGMA = 3.0


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
            "fixes": found.fixes,
            "rms_before": found.rms,
            "nodes": {name: _plain(effects) for name, effects in found.nodes.items()},
            "vehicle": _plain(found.vehicle),
            "unseen": list(found.unseen),
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
        console.print(
            f"{self.result.fixes} positions ({self.positions}); before calibration the track was "
            f"{self.result.rms:.2f} m rms from them",
            highlight=False,
        )
        for line in self.result.unseen:
            console.print(f"not seen: {line}", highlight=False, markup=False, soft_wrap=True)
        for line in self.result.warnings:
            console.print(f"warning: {line}", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo calibrate wheels`."""
    parser.add_argument("log", type=Path, metavar="LOG", help="MCAP recording, or a CSV folder")
    parser.add_argument("--vehicle", type=Path, required=True, metavar="TOML", help="[vehicle] and [nodes.*]")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="TOML", help="calibration file; added to"
    )


def run(args: argparse.Namespace) -> CalibratedWheels:
    """Read, calibrate, add to the calibration file."""
    vehicle = load_vehicle(args.vehicle)
    recording = read_folder(args.log) if args.log.is_dir() else read_recording(args.log)
    before = read_calibration(args.output) if args.output.exists() else Calibration()
    kind, t, x, y, sigma = _positions(recording, str(args.log))
    try:
        config = wheel_config(vehicle, list(recording.nodes))
    except ValueError as error:
        raise InputError(f"{args.log}: {error}; name the nodes in the vehicle file as in the log") from None
    found = calibrate_wheels(config, recording.nodes, t, x, y, sigma)
    provenance: dict[str, Any] = {
        "method": f"wheel filter with {found.fixes} positions ({kind})",
        "source_sha256": source_hash(args.log),
        "date": datetime.now(UTC).date().isoformat(),
    }
    made = before
    for name in found.nodes:
        effects = found.effects(name, **provenance, temperature=_span(recording.nodes[name]))
        made = made.with_node(name, effects, node_serial(recording.metadata, name))
    made = made.with_vehicle(found.vehicle_effects(**provenance))
    write_calibration(made, args.output)
    return CalibratedWheels(str(args.output), kind, found)


def _positions(recording: Recording, log: str) -> tuple[str, Array, Array, Array, Array]:
    """Truth where there is one, else GNSS: its name, t, x, y and sigma."""
    truth, gnss = recording.truth, recording.gnss
    if truth is not None:
        return "truth", truth.t, truth["x"], truth["y"], np.full(len(truth), TRUTH_SIGMA)
    if gnss is None or len(gnss) == 0:
        raise InputError(f"{log}: has neither truth nor GNSS; calibrate wheels needs to know where it was")
    frame = local_frame(float(gnss["latitude_deg"][0]), float(gnss["longitude_deg"][0]))
    x, y = frame.to_local(gnss["latitude_deg"], gnss["longitude_deg"])
    sigma = gnss["sigma"] if "sigma" in gnss else np.full(len(gnss), GNSS_SIGMA)
    sound = np.isfinite(x) & np.isfinite(y) & np.isfinite(sigma) & (sigma > 0)
    return "gnss", gnss.t[sound], x[sound], y[sound], sigma[sound]


def _span(table: Table) -> tuple[float, float] | None:
    if "temperature" not in table:
        return None
    known = table["temperature"][np.isfinite(table["temperature"])]
    return (float(known.min()), float(known.max())) if len(known) else None


def _plain(effects: Any) -> dict[str, dict[str, dict[str, float]]]:
    def one(q: Quantity) -> dict[str, float]:
        return {"value": q.value, "sigma": q.sigma}

    return {name: {p: one(q) for p, q in parameters.items()} for name, parameters in effects.items()}
