"""The inputs of a model as a log has them: speed, yaw rate and their noise, temperature, supply."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import REFERENCE_CELSIUS
from hubodo.errors import InputError
from hubodo.fuse.wheel.window import WINDOW_S
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.model.inputs import Trace
from hubodo.model.model_file import Model, split_input
from hubodo.recording import Recording, Table
from hubodo.smoothing_spline import SmoothingSpline, constant_spline, fit_smoothing_spline
from hubodo.vehicle import facing_sign

# White noise scatters no more than this beside its steps from sample to sample.
_LEVEL = 1.04
# An input may scatter by so many times what is declared; less than so much of a gyro's noise is not felt.
_MORE, _FELT = 1.5, 0.1


@dataclass(frozen=True)
class LogInputs:
    """speed m/s, yaw_rate rad/s: of the vehicle, None where the model file has a number.

    first, last: s, between which the log has both; infinite where it needs neither. measured_by: nodes whose
    z gyro is the speed. speed_period, yaw_rate_period: s between samples."""

    speed: SmoothingSpline | None
    yaw_rate: SmoothingSpline | None
    first: float
    last: float
    measured_by: tuple[str, ...]
    speed_period: float
    yaw_rate_period: float


def read_inputs(recording: Recording, model: Model, origin: float, where: str) -> LogInputs:
    """What the log has of the inputs that the model asks for. origin: s, when the log began.

    Raises InputError when it lacks one.
    """
    speed, first, last, measured_by = _speed(recording, model, origin, where)
    yaw_rate, yaw_first, yaw_last = _yaw_rate(recording, model, origin, where)
    period = _period(recording, model.inputs.speed)
    yaw_period = WINDOW_S if model.inputs.yaw_rate == "nodes" else _period(recording, model.inputs.yaw_rate)
    first, last = max(first, yaw_first), min(last, yaw_last)
    return LogInputs(speed, yaw_rate, first, last, measured_by, period, yaw_period)


def input_noises(
    model: Model,
    speed: SmoothingSpline,
    yaw_rate: SmoothingSpline,
    measured_by: tuple[str, ...],
    warnings: list[str],
) -> tuple[float, float]:
    """1 sigma of a sample of the speed, m/s, and of the yaw rate, rad/s."""
    gyro, radius = model.noise.gyro, model.vehicle.wheel_radius
    of_gyros = radius * gyro / len(measured_by) ** 0.5 if measured_by else 0.0
    declared = model.inputs.speed_noise or of_gyros
    speed_noise = _input_noise(model.inputs.speed, "m/s", speed, declared, _FELT * radius * gyro, warnings)
    declared = model.inputs.yaw_rate_noise or (gyro if _is_gyro(model.inputs.yaw_rate) else 0.0)
    yaw_noise = _input_noise(model.inputs.yaw_rate, "rad/s", yaw_rate, declared, _FELT * gyro, warnings)
    return speed_noise, yaw_noise


def _is_gyro(name: str | float) -> bool:
    return isinstance(name, str) and split_input(name)[0] not in ("reference", "nodes")


def _input_noise(
    name: str | float, unit: str, source: SmoothingSpline, declared: float, felt: float, warnings: list[str]
) -> float:
    """1 sigma of a sample of an input; none of a number, and of one that stands still.

    What gyros measured has the noise of gyros where nothing is declared. Where the samples scatter more than
    declared, and enough to be felt, they are believed, and that is said.
    """
    if source.noise <= 0.0:
        return 0.0
    if source.noise <= max(_MORE * declared, felt):
        return declared
    if name == "nodes":
        # Nobody can know it beforehand.
        return source.noise
    warnings.append(
        f"{name} scatters by {source.noise:.2g} {unit} from sample to sample, more than the {declared:.2g} "
        "that [inputs] declares: taken for its noise; correct it there"
    )
    return source.noise


def _speed(
    recording: Recording, model: Model, origin: float, where: str
) -> tuple[SmoothingSpline | None, float, float, tuple[str, ...]]:
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
    return fit_smoothing_spline(t, mean), float(first), float(last), tuple(sources)


def _yaw_rate(
    recording: Recording, model: Model, origin: float, where: str
) -> tuple[SmoothingSpline | None, float, float]:
    name = model.inputs.yaw_rate
    if not isinstance(name, str):
        return None, -np.inf, np.inf
    if name == "nodes":
        return _across(recording, model, origin, where)
    return _column(recording, name, origin, where)


def _across(
    recording: Recording, model: Model, origin: float, where: str
) -> tuple[SmoothingSpline, float, float]:
    """What the odometry makes of the gyros across the axles, from the whole log."""
    odometry = compute_wheel_odometry(recording, model.vehicle, log=where, lag=np.inf)
    if not odometry.nodes or len(odometry.track.t) < 11:
        raise InputError(f'{where}: yaw_rate = "nodes" needs a node on a wheel that has driven for a while')
    # Each is the mean of the window that ends there; the first pose, the start, ends none.
    t = odometry.track.t[1:] - 0.5 * WINDOW_S - origin
    return _behind(t, odometry.track.yaw_rate[1:]), float(t[0]), float(t[-1])


def _column(
    recording: Recording, name: str, origin: float, where: str
) -> tuple[SmoothingSpline, float, float]:
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


def _behind(t: Array, values: Array) -> SmoothingSpline:
    """The function of time behind an input; a level in white noise is its mean, as well as that is known."""
    white = float(np.median(np.abs(np.diff(values)))) / 0.6745 / np.sqrt(2.0)
    if float(np.std(values)) <= _LEVEL * white or not np.ptp(values):
        mean = float(np.mean(values))
        still = abs(mean) < 4.0 * white / np.sqrt(len(values))
        if still:
            return constant_spline(0.0, float(t[0]), float(t[-1]))
        # Where the mean is off, a wheel turns on and on at another pace than the model's: to a filter of its
        # angle that is what the noise of all samples, integrated, comes to.
        level = constant_spline(mean, float(t[0]), float(t[-1]))
        return replace(
            level, noise=white, value_noise=white / np.sqrt(len(t)), correlation_time=float(np.ptp(t))
        )
    return fit_smoothing_spline(t, values)


def _period(recording: Recording, name: str | float) -> float:
    """s between samples of an input."""
    stem = name.removeprefix("nodes.").partition(".")[0] if isinstance(name, str) else ""
    table = recording.files().get(stem) or next(iter(recording.nodes.values()))
    return float(np.median(np.diff(table.t)))


def log_temperature(recording: Recording, names: Iterable[str], origin: float) -> Trace:
    """°C of the first table that has them; 25 °C where none has."""
    tables: list[Table | None] = [recording.reference, *(recording.nodes[name] for name in names)]
    found = (trace(table, "temperature", origin) for table in tables if table is not None)
    return next((one for one in found if one is not None), Trace.constant(REFERENCE_CELSIUS))


def trace(table: Table, column: str, origin: float) -> Trace | None:
    """A column where it is known; None where it nowhere is. origin: s, when the log began."""
    if column not in table:
        return None
    known = np.isfinite(table[column])
    return Trace(table.t[known] - origin, table[column][known]) if known.any() else None
