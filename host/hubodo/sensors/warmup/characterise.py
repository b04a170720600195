"""Warm-up analysis of one stationary gyro axis: exponential fit, whiteness tests, next model if needed."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.bias_step import find_bias_step
from hubodo.sensors.even_grid import EvenGrid, place_on_grid
from hubodo.sensors.imu.quantisation import describe_rounding, rounding_sigma
from hubodo.sensors.standstill_channel import StandstillRecord
from hubodo.sensors.standstill_checks import TemperatureStep
from hubodo.sensors.warmup.assess import (
    assess_fit,
    describe_next_model,
    is_sufficient,
    select_next_model,
)
from hubodo.sensors.warmup.fit import WarmupFit, fit_warmup
from hubodo.sensors.warmup.forecast import StatedForm
from hubodo.sensors.warmup.result import WarmupResult, next_model_reason

# A warm-up is slow, so a few thousand block means hold all information about it.
_MAX_BLOCK_MEANS, _MIN_BLOCK_MEANS = 4000, 64
_MIN_DURATION_S = 60.0
_MIN_SIGNIFICANCE_SIGMA = 4.0


def characterise_standstill_warmup(
    standstill: StandstillRecord, *, age: float = 0.0, form: StatedForm | None = None
) -> WarmupResult:
    """Model the warm-up of a checked gyro axis, as `characterise_warmup`; errors name the log."""
    try:
        return characterise_warmup(
            standstill.t,
            standstill.values,
            standstill.channel,
            temperature=standstill.temperature,
            age=age,
            temperature_step=standstill.temperature_step,
            node=standstill.node,
            form=form,
        )
    except InputError as error:
        raise InputError(f"{standstill.source}: {error}") from None


def characterise_warmup(
    t: Array,
    values: Array,
    channel: str,
    *,
    temperature: Array | None = None,
    age: float = 0.0,
    temperature_step: TemperatureStep | None = None,
    node: str = "",
    form: StatedForm | None = None,
) -> WarmupResult:
    """Fit C1 (1 - e^(-t/T)) + C2 to a stationary gyro axis and test it (Barshan, Durrant-Whyte, eq. 1 to 4).

    t: (N,) s. values: (N,) rad/s. temperature: (N,) °C or None. age: time since power-on at the first
    sample, s. node: name of the node. form: stated form of the forecast; None averages all. Raises InputError
    if the record is too short or constant, or contains a temperature step.
    """
    _refuse_temperature_step(temperature_step)
    record = place_on_grid(t, values)
    if record.duration < _MIN_DURATION_S or len(t) < _MIN_BLOCK_MEANS:
        raise InputError(
            f"{record.duration:.3g} s with {len(t)} samples is too short for a warm-up; record from power-on "
            "for at least three time constants, some tens of minutes for a MEMS gyro"
        )
    rounding, step = rounding_sigma(values)
    times, means, mean_temperatures = _block_means(record, t, temperature)
    times = times - times[0] + age + 0.5 * (times[1] - times[0])
    exponential = assess_fit(fit_warmup(times, means), record, age, None)
    notes = [*record.notes, *_note_on_rounding(step, rounding, means)]
    reason = _reason_not_determined(exponential.fit, times, means)
    next_model = None
    if exponential.ljung_box.is_white:
        if not exponential.autocorrelation.is_white:
            notes.append(
                "the block means are white, neighbouring samples are not: this is due to the bandwidth of "
                "the sensor or to vibration, not to the warm-up model"
            )
    else:
        _check_bias_step(times - age + t[0], means, exponential.fit.residual)
        next_model = select_next_model(
            exponential, times, means, mean_temperatures, record, t, temperature, age
        )
        notes.append(describe_next_model(exponential, next_model))
    accepted = None if reason else exponential
    if next_model is not None and (not reason or is_sufficient(next_model, exponential)):
        accepted = next_model
        reason = next_model_reason(next_model.fit)
    return WarmupResult(
        channel,
        exponential,
        reason,
        next_model,
        accepted,
        age,
        times,
        means,
        mean_temperatures,
        record,
        tuple(notes),
        node,
        rounding=rounding,
        form=form,
    )


def _refuse_temperature_step(step: TemperatureStep | None) -> None:
    if step is not None:
        raise InputError(
            f"the temperature steps by {step.change:+.2f} °C at {step.t:.6g} s, and a warm-up fitted across "
            f"it would measure the room; use --end {step.t:.6g} for the part before it, or record at "
            "constant temperature"
        )


def _note_on_rounding(step: float, rounding: float, means: Array) -> list[str]:
    """Return a remark if the rounding exceeds the noise of the mean of the record."""
    noise = float(np.std(np.diff(means))) / math.sqrt(2.0 * len(means))
    return [describe_rounding(step, rounding)] if rounding > noise else []


def _check_bias_step(times: Array, means: Array, residual: Array) -> None:
    """Raise InputError if the means or the residual of the exponential step; times: (M,) s of the log."""
    step = find_bias_step(times, means) or find_bias_step(times, residual)
    if step is not None:
        raise InputError(
            f"the rate steps by {math.degrees(step.change):+.3g} deg/s at {step.t:.6g} s, as after a blow or "
            f"a change of the supply, which no warm-up does; use --end {step.t:.6g} for the part before it"
        )


def _block_means(record: EvenGrid, t: Array, temperature: Array | None) -> tuple[Array, Array, Array | None]:
    """Return times, means of the samples present and temperatures of at most `_MAX_BLOCK_MEANS` blocks."""
    size = max(1, len(record.values) // _MAX_BLOCK_MEANS)
    blocks = len(record.values) // size
    count = blocks * size
    present_count = record.present[:count].reshape(blocks, size).sum(axis=1)
    used = 2 * present_count >= size
    sums = np.where(record.present, record.values, 0.0)[:count].reshape(blocks, size).sum(axis=1)
    times = record.start + (np.arange(blocks) + 0.5) * size * record.dt
    mean_temperatures = None if temperature is None else np.interp(times[used], t, temperature)
    return times[used], sums[used] / present_count[used], mean_temperatures


def _reason_not_determined(fit: WarmupFit, times: Array, means: Array) -> str:
    """Return the reason why c1 and the time constant are not determined, or "" if they are."""
    c1, constant = fit.values["c1"], fit.values["time_constant"]
    duration = float(times[-1] - times[0])
    drift = _bias_drift(fit, duration)
    change = abs(c1 * math.expm1(-duration / constant))
    variance = fit.noise**2 * fit.variance_inflation
    improvement = (float(np.sum((means - means.mean()) ** 2)) - float(fit.residual @ fit.residual)) / variance
    # Five sigma are required, because the curve has two parameters more than a constant, one of them searched
    # over decades.
    if change < _MIN_SIGNIFICANCE_SIGMA * drift or improvement < 25.0:
        return (
            f"no significant warm-up: the bias drifts by {math.degrees(drift):.2g} deg/s over the record "
            "without it; a warm-up, if there is one, changes it by less than "
            f"{math.degrees(change + 2 * drift):.2g} deg/s"
        )
    # With a time constant beyond the record the curve is a straight line; it must fit better than a line
    # by four sigma.
    line = np.polynomial.Polynomial.fit(times, means, 1)
    curvature = float(np.sum((means - line(times)) ** 2) - fit.residual @ fit.residual) / variance
    if curvature > _MIN_SIGNIFICANCE_SIGMA**2 and fit.is_determined:
        return ""
    if duration > 3.0 * constant:
        return (
            f"the warm-up is significant, but noise hides its time constant ({constant:.3g} s, sigma "
            f"{fit.sigma['time_constant']:.3g} s): record more samples per second"
        )
    return (
        f"the record of {duration:.4g} s shows a drift but not its end, so c1 and the time constant are "
        f"not separable (time constant {constant:.3g} s, sigma {fit.sigma['time_constant']:.3g} s); record "
        f"from power-on for {3 * max(constant, duration):.2g} s or more"
    )


def _bias_drift(fit: WarmupFit, duration: float) -> float:
    """Return the bias drift over the record, warm-up removed, rad/s: noise of the means and random walk."""
    tenths = [part.mean() for part in np.array_split(fit.residual, 10)]
    steps = float(np.mean(np.diff(tenths) ** 2))
    return math.sqrt(steps * (10.0 if fit.variance_inflation > 1.0 else 1.0))
