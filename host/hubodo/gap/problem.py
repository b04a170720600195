"""A log and a model brought together: what each node measured, and what drives the model of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.gap.plausible import check
from hubodo.model.forward import NodeForward
from hubodo.model.inputs import Inputs
from hubodo.model.model_file import Model, split_input
from hubodo.recording import Recording, Table
from hubodo.smooth import Smooth, constant, smooth
from hubodo.vehicle import NodeMount, facing_sign

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
SHORTEST = 20.0
# White noise scatters no more than this beside its steps from sample to sample.
_LEVEL = 1.04
# So many equal largest readings are no chance.
_PILED = 6
# An input may scatter by so many times what is declared; less than so much of a gyro's noise is not felt.
_MORE, _FELT = 1.5, 0.1


@dataclass(frozen=True)
class NodeData:
    """What one node measured. t: (N,) s since the log began. y: (6, N) gx gy gz rad/s, ax ay az m/s².

    used: (6,) which channels take part; a channel that never changes says nothing. limits: of gyro rad/s and
    accelerometer m/s², beyond which nothing was read as it seems; infinity where nothing piles up.
    """

    name: str
    mount: NodeMount
    t: Array
    y: Array
    used: NDArray[np.bool_]
    limits: tuple[float, float]
    forward: NodeForward

    @property
    def clipped(self) -> NDArray[np.bool_]:
        """(6, N): readings at the limit of their sensor."""
        limits = np.repeat(self.limits, 3)[:, None]
        return np.asarray(np.abs(self.y) >= limits * (1.0 - 1e-9))

    @property
    def on_wheel(self) -> bool:
        return self.mount.side is not None

    @cached_property
    def accel_scatter(self) -> float:
        """m/s²: 1 sigma of white noise in ax and ay, from their second differences, whatever is declared."""
        bent = np.diff(self.y[3:5], 2, axis=1)
        return float(np.median(np.abs(bent)) / 0.6745 / np.sqrt(6.0))


@dataclass(frozen=True)
class Problem:
    """Everything a search for effects works on.

    speed_noise m/s, yaw_rate_noise rad/s: 1 sigma of a sample of the inputs. speed_period, yaw_rate_period: s
    between those. measured_by: nodes whose z gyro is the
    speed input, () when the log has a reference. warnings: one line each.
    """

    model: Model
    nodes: tuple[NodeData, ...]
    inputs: Inputs
    speed_noise: float
    yaw_rate_noise: float
    speed_period: float
    yaw_rate_period: float
    duration: float
    measured_by: tuple[str, ...]
    warnings: tuple[str, ...]


def build(recording: Recording, model: Model, where: str = "log") -> Problem:
    """The problem that a recording poses to a model.

    Raises InputError when the log lacks what the model needs, is shorter than 20 s, has no node of the model,
    or cannot belong to it.
    """
    names = [name for name in model.vehicle.nodes if name in recording.nodes]
    if not names:
        raise InputError(
            f"{where}: has none of the model's nodes ({', '.join(model.vehicle.nodes) or 'it names none'}); "
            f"the log has {', '.join(recording.nodes) or 'no node'}; name them alike in [nodes]"
        )
    warnings = [f"{name}: not in the log" for name in model.vehicle.nodes if name not in names]
    origin = min(float(table.t[0]) for table in recording.files().values() if len(table))
    speed, first, last, measured_by = _speed(recording, model, origin, where)
    yaw_rate, yaw_first, yaw_last = _yaw_rate(recording, model, origin, where)
    first, last = max(first, yaw_first), min(last, yaw_last)
    tables = {name: recording.nodes[name] for name in names}
    first = max(first, min(float(table.t[0]) - origin for table in tables.values()))
    last = min(last, max(float(table.t[-1]) - origin for table in tables.values()))
    if last - first < SHORTEST:
        raise InputError(
            f"{where}: nodes and inputs overlap for {max(last - first, 0.0):.1f} s; "
            f"at least {SHORTEST:.0f} s are needed"
        )
    speed = speed or constant(float(model.inputs.speed), first, last)
    yaw_rate = yaw_rate or constant(float(model.inputs.yaw_rate), first, last)
    temperature = _temperature(recording, names, origin)
    inputs = Inputs(speed, yaw_rate, *temperature)
    nodes = []
    for name in names:
        table = tables[name]
        inside = (table.t - origin >= first) & (table.t - origin <= last)
        t = np.ascontiguousarray(table.t[inside] - origin)
        if len(t) < 100:
            warnings.append(f"{name}: only {len(t)} samples while the inputs last; left out")
            continue
        y = np.stack([table[channel][inside] for channel in CHANNELS])
        used = np.ptp(y, axis=1) > 0.0
        still = [c for c, on in zip(CHANNELS, used, strict=True) if not on]
        if still:
            warnings.append(f"{name}: {', '.join(still)} never change; left out")
        if model.vehicle.nodes[name].side is not None and not used[3:5].all():
            used[[0, 1, 3, 4]] = False
            warnings.append(
                f"{name}: without ax and ay its wheel's angle is unknown; gx and gy are left out too"
            )
        own = inputs
        if "temperature" in table:
            own = Inputs(speed, yaw_rate, table.t - origin, table["temperature"])
        mount = model.vehicle.nodes[name]
        forward = NodeForward(own, t, mount, model.vehicle.wheel_radius, model.vehicle.track_width)
        limits = (pile_up(y[:3]), pile_up(y[3:]))
        nodes.append(NodeData(name, mount, t, y, used, limits, forward))
    if not any(node.used.any() for node in nodes):
        raise InputError(f"{where}: no channel of any node changes; nothing was measured")
    warnings += check(nodes, inputs, measured_by, where)
    gyro, radius = model.noise.gyro, model.vehicle.wheel_radius
    of_gyros = radius * gyro / len(measured_by) ** 0.5 if measured_by else 0.0
    declared = model.inputs.speed_noise or of_gyros
    speed_noise = _input_noise(model.inputs.speed, "m/s", speed, declared, _FELT * radius * gyro, warnings)
    declared = model.inputs.yaw_rate_noise or (gyro if _is_gyro(model.inputs.yaw_rate) else 0.0)
    yaw_noise = _input_noise(model.inputs.yaw_rate, "rad/s", yaw_rate, declared, _FELT * gyro, warnings)
    return Problem(
        model,
        tuple(nodes),
        inputs,
        speed_noise,
        yaw_noise,
        _period(recording, model.inputs.speed),
        _period(recording, model.inputs.yaw_rate),
        last - first,
        measured_by,
        tuple(warnings),
    )


def _is_gyro(name: str | float) -> bool:
    return isinstance(name, str) and split_input(name)[0] != "reference"


def _input_noise(
    name: str | float, unit: str, source: Smooth, declared: float, felt: float, warnings: list[str]
) -> float:
    """1 sigma of a sample of an input; none is left where it is one level.

    What gyros measured has the noise of gyros where nothing is declared. Where the samples scatter more than
    declared, and enough to be felt, they are believed, and that is said.
    """
    if source.noise <= 0.0:
        return 0.0
    if source.noise <= max(_MORE * declared, felt):
        return declared
    warnings.append(
        f"{name} scatters by {source.noise:.2g} {unit} from sample to sample, more than the {declared:.2g} "
        "that [inputs] declares: taken for its noise; correct it there"
    )
    return source.noise


def pile_up(y: Array) -> float:
    """The limit, beyond which a triad reads nothing, (3, N): where its largest readings are all the same.

    Infinity where they are not.
    """
    values, counts = np.unique(np.abs(y), return_counts=True)
    # Noise spreads the largest readings: without a limit, fewer fall on the last value than on those before.
    if len(values) > 4 and counts[-1] >= _PILED and counts[-1] > 3 * counts[-4:-1].max():
        return float(values[-1])
    return np.inf


def _speed(
    recording: Recording, model: Model, origin: float, where: str
) -> tuple[Smooth | None, float, float, tuple[str, ...]]:
    name = model.inputs.speed
    if not isinstance(name, str):
        return None, -np.inf, np.inf, ()
    nodes = [
        n for n in recording.nodes if n in model.vehicle.nodes and model.vehicle.nodes[n].side is not None
    ]
    if name == "nodes":
        sources = nodes
        sides = {model.vehicle.nodes[n].side for n in sources}
        if not sources or len(sides) < min(2, len(sources)):
            raise InputError(
                f'{where}: speed = "nodes" needs a node on each wheel; it has {", ".join(sources) or "none"}'
            )
    elif name.startswith("nodes.") and name.endswith(".gz"):
        sources = [name.split(".")[1]]
    else:
        made, first, last = _column(recording, name, origin, where)
        return made, first, last, ()
    parts = []
    for source in sources:
        if source not in nodes:
            raise InputError(f"{where}: speed = {name!r}: no wheel node {source!r} in log and model")
        table = recording.nodes[source]
        sign = facing_sign(model.vehicle.nodes[source].facing or "left")
        parts.append((table.t - origin, sign * model.vehicle.wheel_radius * table["gz"]))
    first, last = max(p[0][0] for p in parts), min(p[0][-1] for p in parts)
    t = parts[0][0][(parts[0][0] >= first) & (parts[0][0] <= last)]
    mean = np.mean([np.interp(t, *part) for part in parts], axis=0)
    return smooth(t, mean), float(first), float(last), tuple(sources)


def _yaw_rate(
    recording: Recording, model: Model, origin: float, where: str
) -> tuple[Smooth | None, float, float]:
    name = model.inputs.yaw_rate
    if not isinstance(name, str):
        return None, -np.inf, np.inf
    return _column(recording, name, origin, where)


def _column(recording: Recording, name: str, origin: float, where: str) -> tuple[Smooth, float, float]:
    """A column of a file of the log by its name, `reference.speed` or `frame.gz`, smooth."""
    stem, _, column = name.removeprefix("nodes.").partition(".")
    table = recording.files().get(stem)
    if table is None or column not in table:
        has = ", ".join(recording.files())
        raise InputError(
            f"{where}: the model's input {name!r} is not in it (it has {has}); change [inputs] or the log"
        )
    if len(table) < 10:
        raise InputError(f"{where}: the model's input {name!r} has {len(table)} rows; too few")
    t = table.t - origin
    return _behind(t, table[column]), float(t[0]), float(t[-1])


def _behind(t: Array, values: Array) -> Smooth:
    """The function of time behind an input; a level in white noise is that level and nothing of the noise."""
    white = float(np.median(np.abs(np.diff(values)))) / 0.6745 / np.sqrt(2.0)
    if float(np.std(values)) <= _LEVEL * white or not np.ptp(values):
        mean = float(np.mean(values))
        still = abs(mean) < 4.0 * white / np.sqrt(len(values))
        return constant(0.0 if still else mean, float(t[0]), float(t[-1]))
    return smooth(t, values)


def _period(recording: Recording, name: str | float) -> float:
    """s between samples of an input."""
    stem = name.removeprefix("nodes.").partition(".")[0] if isinstance(name, str) else ""
    table = recording.files().get(stem) or next(iter(recording.nodes.values()))
    return float(np.median(np.diff(table.t)))


def _temperature(recording: Recording, names: Iterable[str], origin: float) -> tuple[Array, Array]:
    tables: list[Table | None] = [recording.reference, *(recording.nodes[name] for name in names)]
    for table in tables:
        if table is not None and "temperature" in table:
            return table.t - origin, table["temperature"]
    return np.zeros(1), np.full(1, 25.0)
