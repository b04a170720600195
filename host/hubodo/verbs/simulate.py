"""`hubodo simulate`: simulate a log from a model file."""

import argparse
import dataclasses
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from hubodo.calibration.calibrated_model import add_calibration_to_model
from hubodo.calibration.file import read_calibration
from hubodo.demo.simulated_drive import (
    DRIVE_START_S,
    SimulatedNode,
    add_board_arguments,
    choose_interpreter,
    record_drive,
)
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.node_motion import NodeMotion, SensorDisturbance
from hubodo.errors import InputError
from hubodo.fuse.drive_from_log import estimate_drive_from_fixes, read_reference_drive
from hubodo.log.any_log import read_log
from hubodo.log.csv_folder import write_folder
from hubodo.log.number_recording import InputFormat
from hubodo.log.recording_reader import read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.model import experiments
from hubodo.model.bench import TurntableProgramme
from hubodo.model.experiments import Experiment
from hubodo.model.inputs import EarthRotation, MotionInputs
from hubodo.model.model_file import Model, model_toml, read_model
from hubodo.progress import progress_line
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle
from hubodo.verbs.effect_options import add_effects_option, register_effects
from hubodo.verbs.log_options import add_topic_option, select_topics
from hubodo.verbs.numbers import bounded_number, latitude, seed
from hubodo.verbs.outputs import add_force_option
from hubowire.messages import NODE_IDS

EXAMPLE = "hubodo simulate model.toml --drive random --duration 120 --seed 7 -o drive.mcap"

DRIVES = (*experiments.DRIVES, "reference", "gnss")
_MIN_DURATION_S, _MAX_DURATION_S = 5.0, 36000.0
_RATE_BOUNDS_HZ = (1.0, 10000.0)
_VIRTUAL_NODE_RATES_HZ = (52, 104, 208, 416)


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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo simulate`."""
    parser.add_argument(
        "model", type=Path, metavar="MODEL.toml", help="model file: vehicle, noise, nodes, effects"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="OUT",
        help="log to write (.mcap), or a folder for CSV files",
    )
    add_force_option(parser, "output")
    parser.add_argument(
        "--drive", choices=DRIVES, default="random", help="drive or bench test (default: random)"
    )
    parser.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="LOG",
        help="log or CSV folder for --drive reference and gnss",
    )
    add_topic_option(parser)
    parser.add_argument(
        "--duration",
        type=bounded_number(_MIN_DURATION_S, _MAX_DURATION_S),
        default=120.0,
        help="duration, s (default: 120)",
    )
    parser.add_argument(
        "--rate",
        type=bounded_number(*_RATE_BOUNDS_HZ),
        help="sample rate, Hz (default: 200; with --virtual-node 416)",
    )
    parser.add_argument(
        "--reference-rate",
        type=bounded_number(*_RATE_BOUNDS_HZ),
        default=50.0,
        help="sample rate of the reference, Hz (default: 50)",
    )
    parser.add_argument("--seed", type=seed, default=1, help="seed of drive and noise (default: 1)")
    _add_environment_arguments(parser)
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="calibration file whose errors are added to the nodes",
    )
    add_effects_option(parser)
    _add_bench_arguments(parser)
    parser.add_argument("--virtual-node", action="store_true", help="run the firmware on virtual boards")
    add_board_arguments(parser, " of --virtual-node")


def _add_environment_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for temperature and supply voltage."""
    parser.add_argument(
        "--temperature",
        type=bounded_number(-273.0, 1000.0),
        nargs="+",
        metavar="DEG_C",
        help="one temperature, or the first and the last with a linear change",
    )
    parser.add_argument(
        "--settle",
        type=bounded_number(1e-3),
        metavar="S",
        help="with two temperatures: time constant of an exponential warm-up, s",
    )
    parser.add_argument(
        "--supply",
        type=bounded_number(0.0, 1000.0),
        nargs="+",
        metavar="V",
        help="supply of the nodes: one voltage, or the first and the last with a linear change",
    )


def _add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of a turntable and of static poses."""
    parser.add_argument(
        "--latitude-deg", type=latitude, metavar="L", help="latitude; adds Earth rate to a bench test"
    )
    parser.add_argument(
        "--azimuth-deg",
        type=bounded_number(-360.0, 360.0),
        default=0.0,
        metavar="A",
        help="azimuth of table zero, clockwise from north (default: 0)",
    )
    parser.add_argument(
        "--angles-deg",
        type=bounded_number(-3600.0, 3600.0),
        nargs="+",
        default=(0.0, 180.0),
        help="table angles of the stops (default: 0 180)",
    )
    parser.add_argument(
        "--stop",
        type=bounded_number(1.0, _MAX_DURATION_S),
        default=20.0,
        help="duration of a stop, s (default: 20)",
    )
    parser.add_argument(
        "--turn",
        type=bounded_number(0.1, _MAX_DURATION_S),
        default=2.0,
        help="duration of a turn, s (default: 2)",
    )


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
    _check_arguments(args, model)
    notes: tuple[str, ...] = ()
    if args.calibration:
        model, notes = add_calibration_to_model(model, read_calibration(args.calibration))
    experiment = _experiment(args, model)
    with progress_line() as show:
        if args.virtual_node:
            recording, virtual = _record_virtual_nodes(args, model, experiment, show)
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


def _check_arguments(args: argparse.Namespace, model: Model) -> None:
    """Raise InputError for options that contradict each other, before anything is computed."""
    if not args.output.absolute().parent.is_dir():
        raise InputError(f"{args.output}: its folder does not exist; create it first")
    if args.temperature and len(args.temperature) > 2:
        raise InputError("--temperature: give one number, or the first and the last, in °C")
    if args.settle is not None and (not args.temperature or len(args.temperature) < 2):
        raise InputError("--settle goes with two temperatures; give --temperature FIRST LAST")
    if args.supply and len(args.supply) > 2:
        raise InputError("--supply: give one number, or the first and the last, in V")
    needs_log = args.drive in ("reference", "gnss")
    if needs_log != (args.source is not None):
        raise InputError(
            f"--drive {args.drive} needs --from LOG" if needs_log else "--from goes with reference or gnss"
        )
    if args.latitude_deg is not None and args.drive not in ("turntable", "poses"):
        raise InputError(
            "--latitude-deg goes with --drive turntable or poses; in a drive Earth rate is not simulated"
        )
    if args.virtual_node:
        if args.drive in ("turntable", "poses"):
            raise InputError(f"--virtual-node drives; it cannot do {args.drive}; remove one of them")
        if args.supply:
            raise InputError("--virtual-node: its board measures 3.7 V; remove --supply")
        unknown = [name for name in model.vehicle.nodes if name not in NODE_IDS]
        if unknown:
            raise InputError(
                f"--virtual-node: no node is called {unknown[0]!r} in the protocol; use {', '.join(NODE_IDS)}"
            )
        if args.rate is not None and args.rate not in _VIRTUAL_NODE_RATES_HZ:
            rates = ", ".join(map(str, _VIRTUAL_NODE_RATES_HZ))
            raise InputError(f"--rate {args.rate:g}: the sensor of a virtual node supports {rates} Hz")


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


def _record_virtual_nodes(
    args: argparse.Namespace, model: Model, experiment: Experiment, show: Any
) -> tuple[Recording, dict[str, Any]]:
    """Record the drive with emulated sensors, firmware, ports and the daemon; add reference and truth."""
    interpreter = choose_interpreter(args.interpreter, args.image, args.bootrom)
    vehicle = model.vehicle
    riders = {}
    for name, mount in vehicle.nodes.items():
        effects = experiments.node_effects(model, name, experiment)
        start = experiments.initial_state(model, name, experiment, args.seed)
        motion = NodeMotion(
            experiment.inputs,
            mount,
            vehicle.wheel_radius,
            vehicle.track_width,
            effects,
            start,
            DRIVE_START_S,
            args.seed * 8 + NODE_IDS[name],
        )
        riders[name] = SimulatedNode(motion, SensorDisturbance(model.noise, effects))
    plain = dataclasses.replace(model, effects=())
    with tempfile.TemporaryDirectory(prefix="hubodo-simulate-") as folder:
        result = record_drive(
            riders,
            model_toml(plain),
            Path(folder),
            interpreter,
            args.seed,
            lambda share: show("virtual nodes drive", share),
            416 if args.rate is None else int(args.rate),
            pico=PicoSettings(args.image, args.bootrom),
        )
        recorded = read_recording(result.log)
    drive_start = (result.start_ns - recorded.t_zero_ns) * 1e-9
    reference = experiments.simulate_reference(model, experiment, args.reference_rate, args.seed)
    recording = dataclasses.replace(
        recorded,
        reference=_shift_time(reference, drive_start),
        truth=_shift_time(experiments.true_path(experiment), drive_start) if experiment.has_path else None,
    )
    return recording, result.nodes


def _shift_time(table: Table, delay: float) -> Table:
    return Table({**table.columns, "t": table.t + delay})
