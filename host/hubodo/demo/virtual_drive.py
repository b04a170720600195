"""A drive of a model by virtual nodes: the real firmware on emulated chips, recorded by the real daemon."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

from hubodo.demo.simulated_drive import DRIVE_START_S, SimulatedNode, record_drive
from hubodo.emulator.interpreters.interpreter import InterpreterKind
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.node_motion import NodeMotion, SensorDisturbance
from hubodo.log.recording_reader import read_recording
from hubodo.model import experiments
from hubodo.model.experiments import Experiment
from hubodo.model.model_file import Model
from hubodo.model.model_text import model_toml
from hubodo.progress_callback import Progress
from hubodo.recording import Recording, Table
from hubowire.messages import NODE_IDS


def record_virtual_nodes(
    model: Model,
    experiment: Experiment,
    interpreter: InterpreterKind,
    seed: int,
    *,
    rate_hz: int,
    reference_rate_hz: float,
    pico: PicoSettings,
    on_progress: Progress,
) -> tuple[Recording, dict[str, Any]]:
    """Record the drive with emulated sensors, firmware, ports and the daemon; add reference and truth.

    interpreter: as `choose_interpreter` names it. Returns the recording and statistics of each node.
    """
    vehicle = model.vehicle
    simulated_nodes = {}
    for name, mount in vehicle.nodes.items():
        effects = experiments.node_effects(model, name, experiment)
        start = experiments.initial_state(model, name, experiment, seed)
        motion = NodeMotion(
            experiment.inputs,
            mount,
            vehicle.wheel_radius,
            vehicle.track_width,
            effects,
            start,
            DRIVE_START_S,
            seed * 8 + NODE_IDS[name],
        )
        simulated_nodes[name] = SimulatedNode(motion, SensorDisturbance(model.noise, effects))
    plain = dataclasses.replace(model, effects=())
    with tempfile.TemporaryDirectory(prefix="hubodo-simulate-") as folder:
        result = record_drive(
            simulated_nodes,
            model_toml(plain),
            Path(folder),
            interpreter,
            seed,
            lambda share: on_progress("virtual nodes drive", share),
            rate_hz,
            pico=pico,
        )
        recorded = read_recording(result.log)
    drive_start = (result.start_ns - recorded.t_zero_ns) * 1e-9
    reference = experiments.simulate_reference(model, experiment, reference_rate_hz, seed)
    recording = dataclasses.replace(
        recorded,
        reference=_shift_time(reference, drive_start),
        truth=_shift_time(experiments.true_path(experiment), drive_start) if experiment.has_path else None,
    )
    return recording, result.nodes


def _shift_time(table: Table, delay: float) -> Table:
    return Table({**table.columns, "t": table.t + delay})
