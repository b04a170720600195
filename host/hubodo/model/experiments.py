"""A model and something to do with it, to a recording: what `hubodo simulate` writes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.errors import InputError
from hubodo.model.bench import Handled, Programme
from hubodo.model.drive import loop_drive, path, random_drive
from hubodo.model.forward import Carried, NodeForward, NodeStart
from hubodo.model.inputs import Earth, Inputs, Trace
from hubodo.model.model_file import Model, model_toml
from hubodo.recording import Recording, Table
from hubodo.smoothing_spline import constant_spline
from hubodo.vehicle import NodeMount

DRIVES = ("random", "loop", "rest", "turntable", "poses")
TWO_STOPS = Programme((0.0, np.pi), 20.0, 2.0)
_TRUTH_HZ = 20


@dataclass(frozen=True)
class Experiment:
    """What is done with the nodes.

    inputs: of the vehicle, or of the bench. bench: the nodes are off their wheels and off the vehicle, and so
    are the effects of both. carried: what moves the nodes by hand. table: (K, 3) t, angle, moving of a
    turntable.
    """

    name: str
    inputs: Inputs
    bench: bool = False
    carried: Carried | None = None
    table: Array | None = None

    @property
    def duration(self) -> float:
        return self.inputs.speed.end

    @property
    def drives(self) -> bool:
        """Whether a vehicle goes somewhere, so that there is a path."""
        return not self.bench


def turntable(duration: float, programme: Programme, earth: Earth | None) -> Experiment:
    """Nodes lie flat on a turntable, x along its zero at first."""
    inputs, table = programme.table(duration, earth)
    return Experiment("turntable", inputs, bench=True, table=table)


def poses(duration: float, rng: np.random.Generator, latitude: float | None) -> Experiment:
    """Nodes are carried through random attitudes, six seconds in each.

    Raises InputError when the time does not do for nine, which is what a calibration needs.
    """
    count = int((duration + 2.5) / 8.5)
    if count < 9:
        raise InputError(f"{duration:g} s are enough for {count} poses; give 74 s or more for at least nine")
    handled = Handled(Rotation.random(count, rng=rng), latitude=latitude)
    still = constant_spline(0.0, 0.0, duration)
    return Experiment("poses", Inputs(still, still), bench=True, carried=handled)


def experiment_of(
    kind: str,
    model: Model,
    duration: float,
    seed: int,
    *,
    driven: Inputs | None = None,
    earth: Earth | None = None,
    programme: Programme = TWO_STOPS,
    temperature: Sequence[float] = (),
    settle: float | None = None,
    supply: Sequence[float] = (),
) -> Experiment:
    """One of DRIVES for so many seconds, or what was driven elsewhere.

    driven: the inputs of another kind. earth: what turns under a bench. programme: of a turntable.
    temperature: °C, one or the first and the last; settle: s, as of `warming`. supply: V, as temperature.
    Raises InputError as `poses`.
    """
    rng = np.random.default_rng([seed, 1])
    if driven is not None:
        made = Experiment(kind, driven)
    elif kind == "turntable":
        made = turntable(duration, programme, earth)
    elif kind == "poses":
        made = poses(duration, rng, None if earth is None else earth.latitude)
    elif kind == "random":
        made = Experiment(kind, random_drive(rng, duration))
    elif kind == "loop":
        made = Experiment(kind, loop_drive(rng, rest=1.0, moving=duration - 5.0))
    elif kind == "rest":
        still = constant_spline(0.0, 0.0, duration)
        made = Experiment(kind, Inputs(still, still))
    else:
        raise InputError(f"drive {kind!r}: choose from {', '.join(DRIVES)}")
    made = with_constants(made, model)
    if len(supply):
        made = fed(made, supply[0], supply[-1])
    return warming(made, temperature[0], temperature[-1], settle) if len(temperature) else made


def warming(experiment: Experiment, start: float, end: float, settle: float | None) -> Experiment:
    """The same while the nodes go from `start` to `end` °C: evenly, or by 1 - e^(-t / settle)."""
    t = np.linspace(0.0, experiment.duration, max(2, int(experiment.duration) + 1))
    share = t / t[-1] if settle is None else -np.expm1(-t / settle)
    inputs = replace(experiment.inputs, temperature=Trace(t, start + (end - start) * share))
    return replace(experiment, inputs=inputs)


def fed(experiment: Experiment, start: float, end: float) -> Experiment:
    """The same while the supply of the nodes goes evenly from `start` to `end` V."""
    supply = Trace(np.array([0.0, experiment.duration]), np.array([start, end]))
    return replace(experiment, inputs=replace(experiment.inputs, supply=supply))


def with_constants(experiment: Experiment, model: Model) -> Experiment:
    """The same with inputs that the model file gives as numbers in their place."""
    inputs, names = experiment.inputs, model.inputs
    if not isinstance(names.speed, str):
        inputs = replace(inputs, speed=constant_spline(names.speed, 0.0, experiment.duration))
    if not isinstance(names.yaw_rate, str):
        inputs = replace(inputs, yaw_rate=constant_spline(names.yaw_rate, 0.0, experiment.duration))
    return replace(experiment, inputs=inputs)


def node_effects(model: Model, node: str, experiment: Experiment) -> tuple[Effect, ...]:
    """The effects of a node in an experiment: on a bench those of wheel and vehicle are gone."""
    effects = model.effects_of(node)
    return tuple(e for e in effects if e.level == "node") if experiment.bench else effects


def start_of(model: Model, node: str, experiment: Experiment, seed: int) -> NodeStart:
    """Where the wheel of a node stands at first, drawn; a node that is on none begins along its axes."""
    if experiment.bench or model.vehicle.nodes[node].side is None:
        return NodeStart()
    return NodeStart(float(_generator(seed, node, "start").uniform(-np.pi, np.pi)))


def simulate(
    model: Model, experiment: Experiment, rate: float, reference_rate: float, seed: int
) -> Recording:
    """One draw of all that would be recorded.

    That is nodes at `rate` Hz, the reference with the model's input noise at `reference_rate` Hz, and the
    truth; the supply where somebody gave one. Each node draws from a generator of its own, so that another
    node or effect does not change its noise. Raises InputError when the model has no node.
    """
    if not model.vehicle.nodes:
        raise InputError("the model has no node; add [nodes.left] with side and facing")
    t = _stamps(experiment.duration, rate)
    vehicle = model.vehicle
    nodes = {}
    for name, mount in vehicle.nodes.items():
        forward = NodeForward(
            experiment.inputs,
            t,
            NodeMount() if experiment.bench else mount,
            vehicle.wheel_radius,
            vehicle.track_width,
            carried=experiment.carried,
        )
        effects, start = node_effects(model, name, experiment), start_of(model, name, experiment, seed)
        reading = forward.sample(effects, start, model.noise, _generator(seed, name, "sensor"))
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
        reference=None if experiment.carried else reference(model, experiment, reference_rate, seed),
        table=table,
        truth=truth(experiment) if experiment.drives else None,
    )


def simulated(recording: Recording, kind: str, model: Model, seed: int) -> Recording:
    """The same with a word in its metadata on how it was drawn."""
    words = {"simulated": kind, "simulated.seed": str(seed), "simulated.model": model_toml(model)}
    return replace(recording, metadata={**recording.metadata, **words})


def reference(model: Model, experiment: Experiment, rate: float, seed: int) -> Table:
    """Speed and yaw rate as a reference would measure them."""
    t = _stamps(experiment.duration, rate)
    rng = _generator(seed, "", "reference")
    names, inputs = model.inputs, experiment.inputs
    columns = {"t": t}
    for key, value, name, noise in (
        ("speed", inputs.speed(t), names.speed, names.speed_noise),
        ("yaw_rate", inputs.yaw_rate(t), names.yaw_rate, names.yaw_rate_noise),
    ):
        # Noise of an input that is a node's own channel is that channel's, not the reference's.
        sigma = noise if isinstance(name, str) and name.startswith("reference.") else 0.0
        columns[key] = value + sigma * rng.standard_normal(len(t))
    return Table(columns)


def truth(experiment: Experiment) -> Table:
    """The path."""
    t, x, y, heading = path(experiment.inputs)
    every = slice(None, None, 100 // _TRUTH_HZ)
    return Table(
        {"t": np.rint(t[every] * 1e9) / 1e9, "x": x[every], "y": y[every], "heading": heading[every]}
    )


def _stamps(duration: float, rate: float) -> Array:
    """(N,) s, whole nanoseconds: what a ROS stamp holds to the last bit."""
    return np.asarray(np.rint(np.arange(int(np.ceil(duration * rate))) * (1e9 / rate)) / 1e9)


def _generator(seed: int, node: str, what: str) -> np.random.Generator:
    return np.random.default_rng([seed, *node.encode(), 0, *what.encode()])
