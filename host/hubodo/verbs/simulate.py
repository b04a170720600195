"""`hubodo simulate`: simulate a log from a model file."""

import argparse
import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from hubodo.calibration.calibrated_model import add_calibration_to_model
from hubodo.calibration.file import read_calibration
from hubodo.demo.simulated_drive import choose_interpreter
from hubodo.demo.virtual_drive import record_virtual_nodes
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.fuse.drive_from_log import estimate_drive_from_fixes, read_reference_drive
from hubodo.log.any_log import read_log
from hubodo.log.csv_folder import write_folder
from hubodo.log.number_recording import InputFormat
from hubodo.log.recording_writer import write_recording
from hubodo.model import experiments
from hubodo.model.bench import TurntableProgramme
from hubodo.model.experiments import Experiment
from hubodo.model.inputs import EarthRotation, MotionInputs
from hubodo.model.model_file import Model, read_model
from hubodo.progress import progress_line
from hubodo.vehicle import Vehicle
from hubodo.verbs.effect_options import register_effects
from hubodo.verbs.log_options import select_topics
from hubodo.verbs.simulate_arguments import add_arguments, check_arguments

__all__ = ["EXAMPLE", "SimulationResult", "add_arguments", "run"]

EXAMPLE = "hubodo simulate model.toml --drive random --duration 120 --seed 7 -o drive.mcap"


@dataclass(frozen=True)
class SimulationResult:
    """The outcome of a simulation.

    Attributes
    ----------
    output
        Path of the log.
    drive
        Kind of drive or bench test.
    seed
        Seed of drive and noise.
    duration
        Duration, s.
    distance
        Length of the path, m, or None for a bench test.
    samples, effects
        Number of samples and names of the simulated effects, by node.
    virtual
        Statistics of the virtual nodes, if there were any.
    notes
        One line each.
    """

    output: str
    drive: str
    seed: int
    duration: float
    distance: float | None
    samples: Mapping[str, int]
    effects: Mapping[str, tuple[str, ...]]
    virtual: Mapping[str, Mapping[str, Any]] | None
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        summary = dataclasses.asdict(self)
        summary["effects"] = {node: list(names) for node, names in self.effects.items()}
        summary["notes"] = list(self.notes)
        return summary

    def render(self, console: Console) -> None:
        """Print one row for each node, then the seed that reproduces the log."""
        table = TextTable("node", "samples", "effects", title=f"{self.drive}, {self.duration:.1f} s")
        for node, count in self.samples.items():
            table.add_row(node, str(count), ", ".join(self.effects[node]) or "none")
        console.print(table)
        distance = "" if self.distance is None else f"{self.distance:.1f} m, "
        console.print(f"{distance}seed {self.seed}\nlog: {self.output}", highlight=False, markup=False)
        for text in self.notes:
            console.print(f"note: {text}", highlight=False, markup=False, soft_wrap=True)


def run(args: argparse.Namespace) -> SimulationResult:
    """Simulate a log and write it.

    Returns
    -------
    SimulationResult
        Samples and effects by node, the path length and the seed.

    Raises
    ------
    InputError
        If options contradict each other, or the output exists.
    HubodoError
        If a virtual node fails.
    """
    register_effects(args)
    model = read_model(args.model)
    check_arguments(args, model)
    notes: tuple[str, ...] = ()
    if args.calibration:
        model, notes = add_calibration_to_model(model, read_calibration(args.calibration))
    experiment = _experiment(args, model)
    with progress_line() as show:
        if args.virtual_node:
            recording, virtual = record_virtual_nodes(
                model,
                experiment,
                choose_interpreter(args.interpreter, args.image, args.bootrom),
                args.seed,
                rate_hz=416 if args.rate is None else int(args.rate),
                reference_rate_hz=args.reference_rate,
                pico=PicoSettings(args.image, args.bootrom),
                on_progress=show,
            )
        else:
            show("simulating", 0.0)
            rate = 200.0 if args.rate is None else args.rate
            recording = experiments.simulate(model, experiment, rate, args.reference_rate, args.seed)
            virtual = None
        recording = experiments.with_simulation_metadata(recording, args.drive, model, args.seed)
        if args.output.suffix == ".mcap":
            write_recording(recording, args.output, vehicle=model.vehicle, progress=show)
        else:
            write_folder(recording, args.output, progress=show)
    distance = None
    if experiment.has_path:
        t = np.arange(0.0, experiment.duration, 0.01)
        distance = float(np.sum(np.abs(experiment.inputs.speed(t))) * 0.01)
    return SimulationResult(
        str(args.output),
        args.drive,
        args.seed,
        experiment.duration,
        distance,
        {name: len(table) for name, table in recording.nodes.items()},
        {
            name: tuple(effect.name for effect in experiments.node_effects(model, name, experiment))
            for name in recording.nodes
        },
        virtual,
        notes,
    )


def _experiment(args: argparse.Namespace, model: Model) -> Experiment:
    latitude = args.latitude_deg
    return experiments.make_experiment(
        args.drive,
        model,
        args.duration,
        args.seed,
        driven=None if args.source is None else _inputs_from_log(args, model.vehicle),
        earth=None
        if latitude is None
        else EarthRotation(math.radians(latitude), math.radians(args.azimuth_deg)),
        programme=TurntableProgramme(tuple(map(math.radians, args.angles_deg)), args.stop, args.turn),
        temperature=args.temperature or (),
        settle=args.settle,
        supply=args.supply or (),
    )


def _inputs_from_log(args: argparse.Namespace, vehicle: Vehicle) -> MotionInputs:
    """Return the inputs of a drive that follows the log of --from."""
    needed = ("reference",) if args.drive == "reference" else ("gnss",)
    recording = read_log(
        args.source, input_format=InputFormat(topic_selection=select_topics(args, vehicle, needed))
    )
    convert = read_reference_drive if args.drive == "reference" else estimate_drive_from_fixes
    return convert(recording, str(args.source))
