"""Simulation of an experiment: a drive, standstill, turntable or poses, recorded by the nodes of a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.errors import InputError
from hubodo.model.bench import PoseSequence, TurntableProgramme
from hubodo.model.drive import integrate_path, loop_drive, random_drive
from hubodo.model.forward import CarriedMotion, NodeInitialState, NodeModel
from hubodo.model.inputs import EarthRotation, MotionInputs, Trace
from hubodo.model.model_file import Model
from hubodo.model.model_text import model_toml
from hubodo.recording import Recording, Table
from hubodo.smoothing_spline import constant_spline
from hubodo.vehicle import NodeMount

DRIVES = ("random", "loop", "rest", "turntable", "poses")
TWO_STOPS = TurntableProgramme((0.0, np.pi), 20.0, 2.0)
_TRUTH_RATE_HZ = 20


@dataclass(frozen=True)
class Experiment:
    """Motion of all nodes of a model during an experiment.

    Attributes
    ----------
    name : one of `DRIVES`, or the name of a recorded drive.
    inputs : motion of the vehicle or of the bench.
    on_bench : True if the nodes are off the vehicle; effects of vehicle and wheels are then absent.
    carried_motion : motion of nodes that are moved by hand.
    table : (K, 3) record of a turntable: t in s, angle in rad, moving 0 or 1.
    """

    name: str
    inputs: MotionInputs
    on_bench: bool = False
    carried_motion: CarriedMotion | None = None
    table: Array | None = None

    @property
    def duration(self) -> float:
        """Return the duration in s."""
        return self.inputs.speed.end

    @property
    def has_path(self) -> bool:
        """Return True if a vehicle drives, so that a path exists."""
        return not self.on_bench


def turntable_experiment(
    duration: float, programme: TurntableProgramme, earth: EarthRotation | None
) -> Experiment:
    """Return an experiment with nodes flat on a turntable, their x axes initially along its zero."""
    inputs, table = programme.inputs_and_record(duration, earth)
    return Experiment("turntable", inputs, on_bench=True, table=table)


def pose_experiment(duration: float, rng: np.random.Generator, latitude: float | None) -> Experiment:
    """Return an experiment with nodes in random attitudes, six seconds in each; latitude in rad.

    Raise InputError if `duration` allows fewer than nine poses, the minimum of a calibration.
    """
    count = int((duration + 2.5) / 8.5)
    if count < 9:
        raise InputError(f"{duration:g} s allow {count} poses only; give 74 s or more for at least nine")
    sequence = PoseSequence(Rotation.random(count, rng=rng), latitude=latitude)
    still = constant_spline(0.0, 0.0, duration)
    return Experiment("poses", MotionInputs(still, still), on_bench=True, carried_motion=sequence)


def make_experiment(
    kind: str,
    model: Model,
    duration: float,
    seed: int,
    *,
    driven: MotionInputs | None = None,
    earth: EarthRotation | None = None,
    programme: TurntableProgramme = TWO_STOPS,
    temperature: Sequence[float] = (),
    settle: float | None = None,
    supply: Sequence[float] = (),
) -> Experiment:
    """Return one of `DRIVES`, or a drive with given inputs.

    Parameters
    ----------
    kind : name of the experiment.
    model : its constant inputs replace those of the drive.
    duration : s.
    seed : seed of random drives and poses.
    driven : inputs of a drive that was recorded or defined elsewhere.
    earth : rotation of the Earth under a bench.
    programme : programme of a turntable.
    temperature : °C, one value or the first and the last one.
    settle : s, time constant of the temperature, see `with_temperature`.
    supply : V, one value or the first and the last one.

    Raises
    ------
    InputError
        If the kind is unknown, or as `pose_experiment`.
    """
    rng = np.random.default_rng([seed, 1])
    if driven is not None:
        experiment = Experiment(kind, driven)
    elif kind == "turntable":
        experiment = turntable_experiment(duration, programme, earth)
    elif kind == "poses":
        experiment = pose_experiment(duration, rng, None if earth is None else earth.latitude)
    elif kind == "random":
        experiment = Experiment(kind, random_drive(rng, duration))
    elif kind == "loop":
        experiment = Experiment(kind, loop_drive(rng, rest_time=1.0, driving_time=duration - 5.0))
    elif kind == "rest":
        still = constant_spline(0.0, 0.0, duration)
        experiment = Experiment(kind, MotionInputs(still, still))
    else:
        raise InputError(f"drive {kind!r}: choose from {', '.join(DRIVES)}")
    experiment = with_constant_inputs(experiment, model)
    if len(supply):
        experiment = with_supply(experiment, supply[0], supply[-1])
    return (
        with_temperature(experiment, temperature[0], temperature[-1], settle)
        if len(temperature)
        else experiment
    )


def with_temperature(experiment: Experiment, start: float, end: float, settle: float | None) -> Experiment:
    """Return the experiment with a node temperature from `start` to `end` °C.

    The temperature is linear in time, or settles by 1 - e^(-t / settle) with `settle` in s.
    """
    t = np.linspace(0.0, experiment.duration, max(2, int(experiment.duration) + 1))
    progress = t / t[-1] if settle is None else -np.expm1(-t / settle)
    inputs = replace(experiment.inputs, temperature=Trace(t, start + (end - start) * progress))
    return replace(experiment, inputs=inputs)


def with_supply(experiment: Experiment, start: float, end: float) -> Experiment:
    """Return the experiment with a supply of the nodes that changes linearly from `start` to `end` V."""
    supply = Trace(np.array([0.0, experiment.duration]), np.array([start, end]))
    return replace(experiment, inputs=replace(experiment.inputs, supply=supply))


def with_constant_inputs(experiment: Experiment, model: Model) -> Experiment:
    """Return the experiment with the inputs that the model file gives as numbers."""
    inputs, sources = experiment.inputs, model.inputs
    if not isinstance(sources.speed, str):
        inputs = replace(inputs, speed=constant_spline(sources.speed, 0.0, experiment.duration))
    if not isinstance(sources.yaw_rate, str):
        inputs = replace(inputs, yaw_rate=constant_spline(sources.yaw_rate, 0.0, experiment.duration))
    return replace(experiment, inputs=inputs)


def node_effects(model: Model, node: str, experiment: Experiment) -> tuple[Effect, ...]:
    """Return the effects of a node in an experiment; on a bench those of wheels and vehicle are left out."""
    effects = model.effects_of(node)
    return tuple(e for e in effects if e.level == "node") if experiment.on_bench else effects


def initial_state(model: Model, node: str, experiment: Experiment, seed: int) -> NodeInitialState:
    """Return the initial state of a node: a random wheel angle; zero for a node that is on no wheel."""
    if experiment.on_bench or model.vehicle.nodes[node].side is None:
        return NodeInitialState()
    return NodeInitialState(float(_generator(seed, node, "start").uniform(-np.pi, np.pi)))


def simulate(
    model: Model, experiment: Experiment, rate: float, reference_rate: float, seed: int
) -> Recording:
    """Simulate the recording of an experiment.

    Each node has its own random generator, so that adding a node or an effect does not change its noise.

    Parameters
    ----------
    model : nodes, noise and effects.
    experiment : motion of the nodes.
    rate : Hz, sampling rate of the nodes.
    reference_rate : Hz, sampling rate of the reference, which has the input noise of the model.
    seed : seed of all random generators.

    Returns
    -------
    Recording
        Nodes, reference and true path; the supply voltage if the experiment sets it.

    Raises
    ------
    InputError
        If the model has no node.
    """
    if not model.vehicle.nodes:
        raise InputError("the model has no node; add [nodes.left] with side and facing")
    t = _stamps(experiment.duration, rate)
    vehicle = model.vehicle
    nodes = {}
    for name, mount in vehicle.nodes.items():
        node_model = NodeModel(
            experiment.inputs,
            t,
            NodeMount() if experiment.on_bench else mount,
            vehicle.wheel_radius,
            vehicle.track_width,
            carried_motion=experiment.carried_motion,
        )
        effects, start = node_effects(model, name, experiment), initial_state(model, name, experiment, seed)
        reading = node_model.draw_reading(effects, start, model.noise, _generator(seed, name, "sensor"))
        columns = dict(zip(("gx", "gy", "gz"), reading.gyro, strict=True))
        columns |= dict(zip(("ax", "ay", "az"), reading.accel, strict=True))
        columns["temperature"] = reading.body.temperature
        if len(experiment.inputs.supply.t) > 1:
            columns["supply"] = reading.body.supply
        nodes[name] = Table({"t": t, **columns})
    table = None
    if experiment.table is not None:
        table = Table(dict(zip(("t", "angle", "moving"), experiment.table.T, strict=True)))
    return Recording(
        nodes,
        reference=None
        if experiment.carried_motion
        else simulate_reference(model, experiment, reference_rate, seed),
        table=table,
        truth=true_path(experiment) if experiment.has_path else None,
    )


def with_simulation_metadata(recording: Recording, kind: str, model: Model, seed: int) -> Recording:
    """Return the recording with kind, seed and model of its simulation in the metadata."""
    origin = {"simulated": kind, "simulated.seed": str(seed), "simulated.model": model_toml(model)}
    return replace(recording, metadata={**recording.metadata, **origin})


def simulate_reference(model: Model, experiment: Experiment, rate: float, seed: int) -> Table:
    """Return speed and yaw rate as a reference at `rate` Hz measures them."""
    t = _stamps(experiment.duration, rate)
    rng = _generator(seed, "", "reference")
    sources, inputs = model.inputs, experiment.inputs
    columns = {"t": t}
    for key, value, source, noise in (
        ("speed", inputs.speed(t), sources.speed, sources.speed_noise),
        ("yaw_rate", inputs.yaw_rate(t), sources.yaw_rate, sources.yaw_rate_noise),
    ):
        # Input noise belongs to the reference only if the reference is the source of the input.
        sigma = noise if isinstance(source, str) and source.startswith("reference.") else 0.0
        columns[key] = value + sigma * rng.standard_normal(len(t))
    return Table(columns)


def true_path(experiment: Experiment) -> Table:
    """Return the true path of the vehicle: t in s, x and y in m, heading in rad."""
    t, x, y, heading = integrate_path(experiment.inputs)
    every = slice(None, None, 100 // _TRUTH_RATE_HZ)
    return Table(
        {"t": np.rint(t[every] * 1e9) / 1e9, "x": x[every], "y": y[every], "heading": heading[every]}
    )


def _stamps(duration: float, rate: float) -> Array:
    """Return time stamps (N,), s, rounded to nanoseconds as ROS stores them; rate in Hz."""
    return np.asarray(np.rint(np.arange(int(np.ceil(duration * rate))) * (1e9 / rate)) / 1e9)


def _generator(seed: int, node: str, purpose: str) -> np.random.Generator:
    """Return the random generator of a node for one purpose; all generators are independent."""
    return np.random.default_rng([seed, *node.encode(), 0, *purpose.encode()])
