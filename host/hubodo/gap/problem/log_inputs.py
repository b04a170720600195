"""Inputs of a model as recorded in a log: speed and yaw rate with their noise, temperature, supply."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import REFERENCE_CELSIUS
from hubodo.errors import InputError
from hubodo.fuse.wheel.window import WINDOW_S
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.gap.problem.clock_alignment import align_times
from hubodo.gap.problem.motion_band import estimate_motion_band
from hubodo.gap.problem.saturation import is_spin_saturated, weigh_speed_sources
from hubodo.model.inputs import Trace
from hubodo.model.model_file import Model, split_input
from hubodo.recording import Recording, Table
from hubodo.smoothing_spline import SmoothingSpline, constant_spline, fit_smoothing_spline
from hubodo.vehicle import facing_sign, side_sign

# Ratio of the standard deviation to the sample-to-sample noise up to which an input is taken for constant.
_MAX_CONSTANT_RATIO = 1.04
# Ratio of measured to declared noise of an input above which the measured one is used; input noise below this
# share of a gyro's noise is negligible.
_MAX_NOISE_RATIO, _NEGLIGIBLE_NOISE_SHARE = 1.5, 0.1
# rad/s; usual bias of a MEMS gyro.
_GYRO_BIAS_SIGMA = 0.01


@dataclass(frozen=True)
class LogInputs:
    """Inputs read from a log.

    speed, yaw_rate: m/s and rad/s of the vehicle; None where the model file gives a constant
    first, last: s, the span covered by both inputs; infinite if none comes from the log
    speed_sources: names of the nodes whose z gyro measures the speed
    speed_period, yaw_rate_period: s between samples
    """

    speed: SmoothingSpline | None
    yaw_rate: SmoothingSpline | None
    first: float
    last: float
    speed_sources: tuple[str, ...]
    speed_period: float
    yaw_rate_period: float


def read_inputs(recording: Recording, model: Model, origin: float, log_name: str) -> LogInputs:
    """Read the inputs that the model requires; `origin` is the start of the log in s.

    Raises InputError if an input is missing.
    """
    # The speed from the wheels requires the yaw rate; if both inputs are missing, the error names the speed.
    if isinstance(model.inputs.speed, str) and not model.inputs.speed.startswith("nodes"):
        _find_input(recording, model.inputs.speed, log_name)
    yaw_rate, yaw_first, yaw_last = _read_yaw_rate(recording, model, origin, log_name)
    speed, first, last, speed_sources = _read_speed(recording, model, origin, log_name, yaw_rate)
    period = _sample_period(recording, model.inputs.speed)
    yaw_period = (
        WINDOW_S if model.inputs.yaw_rate == "nodes" else _sample_period(recording, model.inputs.yaw_rate)
    )
    first, last = max(first, yaw_first), min(last, yaw_last)
    return LogInputs(speed, yaw_rate, first, last, speed_sources, period, yaw_period)


def estimate_input_noise(
    model: Model,
    speed: SmoothingSpline,
    yaw_rate: SmoothingSpline,
    speed_sources: tuple[str, ...],
    warnings: list[str],
) -> tuple[float, float]:
    """Return 1 sigma of one sample of the speed, m/s, and of the yaw rate, rad/s."""
    gyro, radius = model.noise.gyro, model.vehicle.wheel_radius
    from_gyros = radius * gyro / len(speed_sources) ** 0.5 if speed_sources else 0.0
    declared = model.inputs.speed_noise or from_gyros
    speed_noise = _choose_input_noise(
        model.inputs.speed, "m/s", speed, declared, _NEGLIGIBLE_NOISE_SHARE * radius * gyro, warnings
    )
    declared = model.inputs.yaw_rate_noise or (gyro if _is_gyro(model.inputs.yaw_rate) else 0.0)
    yaw_noise = _choose_input_noise(
        model.inputs.yaw_rate, "rad/s", yaw_rate, declared, _NEGLIGIBLE_NOISE_SHARE * gyro, warnings
    )
    return speed_noise, yaw_noise


def yaw_rate_offset_sigma(model: Model) -> float:
    """Return 1 sigma of a constant error of the yaw rate, rad/s: the bias of a gyro that measured it."""
    return _GYRO_BIAS_SIGMA if _is_gyro(model.inputs.yaw_rate) else 0.0


def _is_gyro(name: str | float) -> bool:
    return isinstance(name, str) and split_input(name)[0] not in ("reference", "nodes")


def _choose_input_noise(
    name: str | float,
    unit: str,
    source: SmoothingSpline,
    declared: float,
    negligible: float,
    warnings: list[str],
) -> float:
    """Return 1 sigma of one sample of an input; 0 for a constant and at standstill.

    The measured scatter replaces a declared noise that is clearly too small, with a warning.
    """
    if source.noise <= 0.0:
        return 0.0
    if source.noise <= max(_MAX_NOISE_RATIO * declared, negligible):
        return declared
    if name == "nodes":
        # The noise of the wheels' odometry cannot be declared in advance.
        return source.noise
    warnings.append(
        f"{name} scatters by {source.noise:.2g} {unit} from sample to sample, more than the {declared:.2g} "
        "declared in [inputs]: the larger value is used; correct it there"
    )
    return source.noise


def _read_speed(
    recording: Recording, model: Model, origin: float, log_name: str, yaw_rate: SmoothingSpline | None
) -> tuple[SmoothingSpline | None, float, float, tuple[str, ...]]:
    """Return the speed, the span in which it is known, and the nodes whose gyros measured it.

    yaw_rate: yaw rate of the vehicle, rad/s; None for a constant
    """
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
                f'{log_name}: speed = "nodes" needs a node on each wheel; '
                f"the log has {', '.join(sources) or 'none'}"
            )
    elif name.startswith("nodes.") and name.endswith(".gz"):
        sources = [name.split(".")[1]]
    else:
        smooth_speed, first, last = _read_column(recording, model, name, origin, log_name)
        return smooth_speed, first, last, ()
    parts, saturated = [], []
    for source in sources:
        if source not in nodes:
            raise InputError(f"{log_name}: speed = {name!r}: no wheel node {source!r} in log and model")
        table = recording.nodes[source]
        sign = facing_sign(model.vehicle.nodes[source].facing or "left")
        parts.append((table.t - origin, sign * model.vehicle.wheel_radius * table["gz"]))
        saturated.append((table.t - origin, is_spin_saturated(table)))
    first, last = max(p[0][0] for p in parts), min(p[0][-1] for p in parts)
    t = parts[0][0][(parts[0][0] >= first) & (parts[0][0] <= last)]
    speeds = [np.interp(t, *part) for part in parts]
    midpoint = _speeds_of_midpoint(model, sources, speeds, yaw_rate, t)
    weights = weigh_speed_sources(t, saturated)
    # The yaw rate matters where only one of two wheels measures.
    speed = (weights * midpoint).sum(axis=0) if len(speeds) > 1 else speeds[0]
    valid = np.where(weights > 0.0, midpoint, speed)
    band = estimate_motion_band(t, valid[0], None if len(valid) < 2 else (t, valid[1]))
    return fit_smoothing_spline(t, speed, band), float(first), float(last), tuple(sources)


def _speeds_of_midpoint(
    model: Model, sources: Sequence[str], speeds: Sequence[Array], yaw_rate: SmoothingSpline | None, t: Array
) -> list[Array]:
    """Return the speed of the midpoint between the wheels, (N,) m/s, as measured by each wheel."""
    if yaw_rate is None:
        return list(speeds)
    turn = 0.5 * model.vehicle.track_width * yaw_rate(t)
    sides = (model.vehicle.nodes[source].side or "left" for source in sources)
    return [speed + side_sign(side) * turn for speed, side in zip(speeds, sides, strict=True)]


def _read_yaw_rate(
    recording: Recording, model: Model, origin: float, log_name: str
) -> tuple[SmoothingSpline | None, float, float]:
    name = model.inputs.yaw_rate
    if not isinstance(name, str):
        return None, -np.inf, np.inf
    if name == "nodes":
        return _yaw_rate_from_wheels(recording, model, origin, log_name)
    return _read_column(recording, model, name, origin, log_name, is_yaw_rate=True)


def _wheel_difference(
    recording: Recording, model: Model, t: Array, yaw_rate: Array
) -> tuple[Array, Array] | None:
    """Return times, s, and the yaw rate, rad/s, from the speeds of two wheels; None if there are not two.

    A delay between the wheels makes each change of speed a difference: it is removed, for which another yaw
    rate is needed, (N,) rad/s at the times t. While one of them is saturated, the yaw rate is NaN.
    """
    wheels = {
        mount.side: (recording.nodes[name], facing_sign(mount.facing or "left"))
        for name, mount in model.vehicle.nodes.items()
        if name in recording.nodes and mount.side is not None
    }
    if len(wheels) < 2:
        return None
    (left, left_sign), (right, right_sign) = wheels["left"], wheels["right"]
    turning = np.interp(left.t, t, yaw_rate)
    right_t = align_times(left.t, left_sign * left["gz"], right.t, right_sign * right["gz"], turning)
    rates = [np.where(is_spin_saturated(wheel), np.nan, wheel["gz"]) for wheel in (left, right)]
    difference = right_sign * np.interp(left.t, right_t, rates[1]) - left_sign * rates[0]
    return left.t, difference * model.vehicle.wheel_radius / model.vehicle.track_width


def _yaw_rate_from_wheels(
    recording: Recording, model: Model, origin: float, log_name: str
) -> tuple[SmoothingSpline, float, float]:
    """Return the yaw rate that the odometry computes from the gyro axes across the axles."""
    odometry = compute_wheel_odometry(recording, model.vehicle, log=log_name, lag=np.inf)
    if not odometry.nodes or len(odometry.track.t) < 11:
        raise InputError(
            f'{log_name}: yaw_rate = "nodes" needs a node on a wheel that has driven for a while'
        )
    # Each value is the mean of the window that ends at its time; the first pose is the start.
    t = odometry.track.t[1:] - 0.5 * WINDOW_S - origin
    return _smooth_input(t, odometry.track.yaw_rate[1:]), float(t[0]), float(t[-1])


def _read_column(
    recording: Recording,
    model: Model,
    name: str,
    origin: float,
    log_name: str,
    is_yaw_rate: bool = False,
) -> tuple[SmoothingSpline, float, float]:
    """Return a smoothed column of the log by its name, `reference.speed` or `frame.gz`, and its time span.

    is_yaw_rate: True if two wheels measure the same motion
    """
    table, column = _find_input(recording, name, log_name)
    if len(table) < 10:
        raise InputError(f"{log_name}: the model's input {name!r} has {len(table)} rows; too few")
    t = table.t - origin
    values = table[column]
    other = _wheel_difference(recording, model, table.t, values) if is_yaw_rate else None
    if other is not None:
        other_t, difference = other
        same = np.interp(other_t, table.t, values)
        other = other_t - origin, np.where(np.isnan(difference), same, difference)
    return _smooth_input(t, values, other), float(t[0]), float(t[-1])


def _find_input(recording: Recording, name: str, log_name: str) -> tuple[Table, str]:
    """Return the table and the column of an input of the model. Raises InputError if the log has none."""
    stem, _, column = name.removeprefix("nodes.").partition(".")
    table = recording.files().get(stem)
    if table is None or column not in table:
        has = ", ".join(recording.files())
        raise InputError(
            f"{log_name}: the model's input {name!r} is not in it (it has {has}); change [inputs] or the log"
        )
    return table, column


def _smooth_input(
    t: Array, values: Array, second_sensor: tuple[Array, Array] | None = None
) -> SmoothingSpline:
    """Return the smooth function behind an input; a constant level in white noise becomes its mean.

    second_sensor: times, s, and samples of another sensor of the same motion, if there is one
    """
    white = float(np.median(np.abs(np.diff(values)))) / 0.6745 / np.sqrt(2.0)
    if float(np.std(values)) <= _MAX_CONSTANT_RATIO * white or not np.ptp(values):
        mean = float(np.mean(values))
        is_zero = abs(mean) < 4.0 * white / np.sqrt(len(values))
        if is_zero:
            return constant_spline(0.0, float(t[0]), float(t[-1]))
        # An error of the mean turns the wheel steadily away from the model: for a filter of the wheel angle
        # that equals the integrated noise of all samples.
        level = constant_spline(mean, float(t[0]), float(t[-1]))
        return replace(
            level, noise=white, value_noise=white / np.sqrt(len(t)), correlation_time=float(np.ptp(t))
        )
    return fit_smoothing_spline(t, values, estimate_motion_band(t, values, second_sensor))


def _sample_period(recording: Recording, name: str | float) -> float:
    """Return the time between samples of an input, s."""
    stem = name.removeprefix("nodes.").partition(".")[0] if isinstance(name, str) else ""
    table = recording.files().get(stem) or next(iter(recording.nodes.values()))
    return float(np.median(np.diff(table.t)))


def read_temperature(recording: Recording, names: Iterable[str], origin: float) -> Trace:
    """Return the temperature, °C, of the first table that has one; 25 °C if none has."""
    tables: list[Table | None] = [recording.reference, *(recording.nodes[name] for name in names)]
    traces = (read_trace(table, "temperature", origin) for table in tables if table is not None)
    return next((trace for trace in traces if trace is not None), Trace.constant(REFERENCE_CELSIUS))


def read_trace(table: Table, column: str, origin: float) -> Trace | None:
    """Return the finite values of a column, None if there are none; `origin` is the start of the log in s."""
    if column not in table:
        return None
    known = np.isfinite(table[column])
    return Trace(table.t[known] - origin, table[column][known]) if known.any() else None
