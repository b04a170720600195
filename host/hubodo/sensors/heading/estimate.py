"""Heading of a node of a log: options, standstills, noise and warm-up of its vertical axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.calibration.file import CalibratedEffect, Calibration
from hubodo.calibration.triad import triad_from_effects
from hubodo.errors import InputError
from hubodo.fuse.heading_filter import BiasNoise
from hubodo.recording import Recording, Table
from hubodo.sensors.heading.bias_walk import TYPICAL_TEMPERATURE_COEFFICIENT, add_bias_walk
from hubodo.sensors.heading.prior import axis_direction, vertical_axis_warmup
from hubodo.sensors.heading.result import HeadingResult
from hubodo.sensors.heading.score import read_true_heading, score_heading
from hubodo.sensors.heading.sensor_change import check_one_sensor
from hubodo.sensors.heading.standstill import (
    DetectedStandstills,
    detect_standstills,
    estimate_angle_random_walk,
    standstills_from_user,
)
from hubodo.sensors.heading.track import estimate_heading
from hubodo.sensors.heading.vertical_axis import Spans, VerticalAxis
from hubodo.sensors.imu.quantisation import (
    describe_rounding,
    find_quantisation_steps,
    rounding_sigma,
)
from hubodo.sensors.imu.uneven_codes import describe_uneven_codes, uneven_mean_sigma
from hubodo.sensors.saturation import check_saturation, saturated_value
from hubodo.sensors.standstill_channel import IMU_CHANNELS, interpolate_temperature

TYPICAL_GYRO_LAG = 0.005  # s
"""Group delay of a gyro with 30 Hz bandwidth, a common setting of MEMS gyros in vehicles."""
TYPICAL_BIAS_INSTABILITY = math.radians(30.0) / 3600.0
"""B of IEEE 952, rad/s: data sheets of commercial MEMS gyros state 10 to 40 degrees per hour."""
_MIN_TEMPERATURE_CHANGE = 0.3
"""°C; with a typical coefficient, smaller changes are within the noise."""
UNCALIBRATED_SCALE_SIGMA = 0.01
"""1σ of the relative scale error of an uncalibrated MEMS gyro; data sheets state 1 to 3 % tolerance."""


@dataclass(frozen=True)
class HeadingOptions:
    """Options that the user gives for a vertical gyro axis.

    Attributes:
        axis: x, y or z.
        effects: calibration of the node.
        noise: noise of the bias; by default from standstills and typical values.
        age: time since power-on at the first sample, s.
        standstills: (from, to) of each, s; detected if empty.
        scale_sigma: relative 1σ of the scale.
        lag: delay of the gyro, s.
        step: time step of the result, s.
    """

    axis: str = "z"
    effects: Mapping[str, CalibratedEffect] = field(default_factory=dict)
    noise: BiasNoise | None = None
    age: float | None = None
    standstills: Sequence[Sequence[float]] = ()
    scale_sigma: float | None = None
    lag: float | None = None
    step: float = 0.1


def effects_of_node(calibration: Calibration, node: str, source: str) -> Mapping[str, CalibratedEffect]:
    """Return the calibrated effects of a node; raise InputError if the calibration lacks it."""
    if node not in calibration.nodes:
        known = ", ".join(calibration.nodes) or "none"
        raise InputError(f"{source} holds no node {node!r}; it has {known}")
    return calibration.nodes[node].effects


def heading_from_recording(
    recording: Recording, node: str, options: HeadingOptions, *, log: str, output: str | None = None
) -> HeadingResult:
    """Return the heading of a node's vertical axis, scored if the log holds a true heading.

    log, output: paths for the result. Raises InputError if the axis is missing or not vertical, or if neither
    standstill nor calibration gives the bias.
    """
    notes = list(recording.warnings)
    table = recording.nodes[node]
    rows = _complete_rows(table, options.axis, notes)
    t, gyro, accel = table.t[rows], table.gyro[rows], table.accel[rows]
    up, note = axis_direction(accel, options.axis)
    notes += [note] if note else []
    effects, index = dict(options.effects), "xyz".index(options.axis)
    rate = triad_from_effects(effects, "gyro").correct(np.nan_to_num(gyro))[:, index]
    axis = VerticalAxis(t, up * rate, up * gyro[:, index], interpolate_temperature(table, rows))
    model, sigmas = vertical_axis_warmup(effects, options.axis, up, thermometer=axis.temperature is not None)
    if options.standstills:
        detected = DetectedStandstills(standstills_from_user(t, options.standstills))
    else:
        expected_bias = model.bias(t - t[0] + (options.age or 0.0), axis.temperature)
        detected = detect_standstills(t, gyro, accel, axis, index, expected_bias, recording.table)
        check_one_sensor(t, axis.raw, detected.spans)
    spans = detected.spans
    notes += detected.notes
    _check_saturation(axis.raw, spans, options.axis, notes)
    notes += [] if spans else [_bias_from_calibration(effects, detected)]
    if options.age is None and model.c1:
        notes.append("power-on is assumed at the first sample; if it was earlier, give --age")
    if not model.c1:
        notes.append("no warm-up model of this axis: soon after power-on its bias drifts by more than sigma")
    sigmas |= _uncalibrated_temperature(axis, spans, sigmas, notes)
    noise = replace(_bias_noise(options, effects, axis, spans, notes), warmup=sigmas)
    noise = add_bias_walk(noise, model, axis, spans, options.age or 0.0, notes)
    scale_sigma = _scale_sigma(options, effects, notes)
    lag = _gyro_delay(options, effects)
    track = estimate_heading(
        axis,
        spans,
        model,
        noise,
        age=options.age or 0.0,
        scale_sigma=scale_sigma,
        lag=lag,
        step=options.step,
        rounding=_rounding(axis, spans, notes),
    )
    notes += _describe_gaps(track.gaps)
    scored = None if (truth := read_true_heading(recording)) is None else score_heading(track, truth)
    return HeadingResult(
        log,
        output,
        node,
        options.axis,
        up > 0,
        tuple((float(t[i]), float(t[j - 1])) for i, j in spans),
        model,
        noise,
        scale_sigma,
        lag,
        track,
        scored,
        tuple(notes),
    )


def _describe_gaps(gaps: Sequence[tuple[float, float]]) -> list[str]:
    if not gaps:
        return []
    longest = max(end - start for start, end in gaps)
    return [f"{len(gaps)} gaps, the longest {longest:.3g} s; sigma covers the rotation in them"]


def _check_saturation(rate: Array, spans: Spans, axis: str, notes: list[str]) -> None:
    """Raise InputError for a gyro saturated in the standstills; add a remark for one saturated in turns."""
    if spans:
        check_saturation(np.concatenate([rate[i:j] for i, j in spans]), f"g{axis} at standstill")
    saturated = saturated_value(rate)
    if saturated is not None:
        notes.append(
            f"{saturated[1]:.1%} of the samples of g{axis} equal {math.degrees(saturated[0]):.4g} deg/s: if "
            "that is the end of its range, the rotation beyond it is missing, and sigma does not contain it"
        )


def _rounding(axis: VerticalAxis, spans: Spans, notes: list[str]) -> float:
    """Return the 1σ of means of the rate that the converter causes, rad/s; add a remark where it matters."""
    ranges = spans or ((0, len(axis.raw)),)
    step = float(find_quantisation_steps(axis.raw[:, None])[0])
    rounding = max(rounding_sigma(axis.raw[i:j], step)[0] for i, j in ranges)
    if rounding > TYPICAL_BIAS_INSTABILITY / 3.0:
        notes.append(describe_rounding(step, rounding))
    uneven, unevenness, step = uneven_mean_sigma(axis.raw[:, None], spans)
    if unevenness:
        codes = describe_uneven_codes("gyro's", unevenness, f"{math.degrees(step):.3g} deg/s")
        bias = math.degrees(float(uneven[0])) * 3600.0
        notes.append(f"{codes}: sigma includes {bias:.3g} °/h of bias for it")
    return float(math.hypot(rounding, float(uneven[0])))


def _bias_from_calibration(effects: Mapping[str, CalibratedEffect], detected: DetectedStandstills) -> str:
    """Return a remark if no standstill gives the bias; raise InputError if no calibration gives it either."""
    if "gyro_bias" not in effects:
        advice = "; begin with a standstill of about ten seconds, mark one with --rest, or give --calibration"
        problem = f": {detected.problem}" if detected.problem else advice
        raise InputError(f"neither a standstill nor a calibration gives the bias{problem}")
    return "no standstill: the bias is that of the calibration, with the day-to-day change as its sigma"


def _complete_rows(table: Table, axis: str, notes: list[str]) -> NDArray[np.int64]:
    """Return the rows with all measured channels; raise InputError for a missing axis or too few rows.

    A remark is added for missing channels.
    """
    missing = [name for name in IMU_CHANNELS if not np.isfinite(table[name]).any()]
    if f"g{axis}" in missing:
        measured = [name for name in IMU_CHANNELS if name not in missing and name[0] == "g"]
        raise InputError(
            f"it has no g{axis}; choose the vertical axis with --axis"
            + (f" {measured[0][1]}" if len(measured) == 1 else "")
        )
    if missing:
        notes.append(
            f"it has no {', '.join(missing)}: gravity and the other axes cannot confirm a standstill"
        )
    measured_columns = np.column_stack([table[name] for name in IMU_CHANNELS if name not in missing])
    rows = np.flatnonzero(np.isfinite(measured_columns).all(axis=1))
    if len(rows) < 100:
        raise InputError(f"{len(rows)} samples are too few for a heading; record several seconds at least")
    return rows


def _uncalibrated_temperature(
    axis: VerticalAxis, spans: Spans, sigmas: Mapping[str, float], notes: list[str]
) -> dict[str, float]:
    """Return the prior of the temperature coefficient if the temperature changes and none is calibrated.

    The standstills determine the bias at their temperatures; the coefficient is a state of the filter.
    """
    if not spans or axis.temperature is None or "temperature_coefficient" in sigmas:
        return {}
    change = float(np.ptp(axis.temperature))
    if not change > _MIN_TEMPERATURE_CHANGE:
        return {}
    notes.append(
        f"the temperature changes by {change:.1f} °C and no coefficient is calibrated: sigma includes "
        f"{math.degrees(TYPICAL_TEMPERATURE_COEFFICIENT):.2g} deg/s per °C, typical of MEMS gyros; hubodo "
        "warmup measures it"
    )
    return {"temperature_coefficient": TYPICAL_TEMPERATURE_COEFFICIENT}


def _bias_noise(
    options: HeadingOptions,
    effects: dict[str, CalibratedEffect],
    axis: VerticalAxis,
    spans: Spans,
    notes: list[str],
) -> BiasNoise:
    """Return N, B and K: as given, else N from standstills, K from the calibration and a typical B."""
    walk = effects.get("gyro_rate_random_walk", CalibratedEffect({})).value("k")
    if options.noise is not None:
        return replace(options.noise, rate_random_walk=options.noise.rate_random_walk or walk)
    white_noise = estimate_angle_random_walk(axis.t, axis.rate, spans)
    if white_noise is None:
        raise InputError(
            "no standstill is long enough to estimate the noise of the axis; give --allan, or --rest with "
            "several seconds of standstill"
        )
    notes.append(
        "bias instability assumed as 30 °/h, typical of MEMS gyros; give --allan for the actual value"
    )
    return BiasNoise(white_noise, TYPICAL_BIAS_INSTABILITY, walk)


def _scale_sigma(options: HeadingOptions, effects: dict[str, CalibratedEffect], notes: list[str]) -> float:
    """Return the relative 1σ of the gyro scale: as given, else calibrated, else typical of MEMS gyros."""
    if options.scale_sigma is not None:
        return float(options.scale_sigma)
    scale = effects.get("gyro_scale_factor", CalibratedEffect({})).parameters.get(options.axis)
    if scale is not None:
        return scale.sigma
    notes.append("the scale is not calibrated: sigma includes 1 % of the net rotation for it")
    return UNCALIBRATED_SCALE_SIGMA


def _gyro_delay(options: HeadingOptions, effects: dict[str, CalibratedEffect]) -> float:
    """Return the delay of the gyro in seconds: as given, else calibrated, else typical of MEMS gyros."""
    known = effects.get("gyro_lag", CalibratedEffect({})).parameters.get("time_constant")
    if options.lag is not None:
        return float(options.lag)
    return TYPICAL_GYRO_LAG if known is None else math.hypot(known.value, known.sigma)
