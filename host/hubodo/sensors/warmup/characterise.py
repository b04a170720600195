"""The warm-up of one gyro axis at rest: fitted, judged for whiteness, and the next model if not white."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.sensors.at_rest import TemperatureStep
from hubodo.sensors.even_grid import EvenGrid, even_grid
from hubodo.sensors.warmup.fit import WarmupFit, fit_warmup
from hubodo.sensors.warmup.judge import judge, next_model, verdict
from hubodo.sensors.warmup.result import WarmupReport, see_next

FloatArray = NDArray[np.float64]

# The warm-up is slow: some thousand means hold all there is to know about it.
_MEANS, _FEWEST_MEANS = 4000, 64
_SHORTEST_S = 60.0
_SIGNIFICANT = 4.0


def characterise_warmup(
    t: FloatArray,
    values: FloatArray,
    channel: str,
    *,
    temperature: FloatArray | None = None,
    age: float = 0.0,
    step: TemperatureStep | None = None,
) -> WarmupReport:
    """Fit C1 (1 - e^(-t/T)) + C2 to a gyro axis at rest and judge it (Barshan, Durrant-Whyte, eq. 1 to 4).

    t: (N,) s; values: (N,) rad/s; temperature: (N,) degrees C or None. age: s since power-on at the first
    sample. Raises InputError: too short, constant, a temperature step.
    """
    if step is not None:
        raise InputError(
            f"the temperature steps by {step.change:+.2f} °C at {step.t:.6g} s: a warm-up fitted across "
            "that would "
            f"measure the room; take the part before it with --end {step.t:.6g}, or record at constant "
            "temperature"
        )
    record = even_grid(t, values)
    if record.duration < _SHORTEST_S or len(t) < _FEWEST_MEANS:
        raise InputError(
            f"{record.duration:.3g} s with {len(t)} samples is too short for a warm-up; record from "
            "power-on for at "
            "least three time constants, which for a MEMS gyro is some tens of minutes"
        )
    times, means, grades = _block_means(record, t, temperature)
    times = times - times[0] + age + 0.5 * (times[1] - times[0])
    first = judge(fit_warmup(times, means), record, age, None)
    notes = list(record.notes)
    reason = _not_earned(first.fit, times, means)
    following = None
    if first.ljung_box.white:
        if not first.autocorrelation.white:
            notes.append(
                "the means are white, neighbouring samples are not: bandwidth or vibration of the sensor, "
                "which no "
                "warm-up model mends"
            )
    else:
        following = next_model(first, times, means, grades, record, t, temperature, age)
        notes.append(verdict(first, following))
    accepted = None if reason else first
    if following is not None and (following.ljung_box.white or not reason):
        accepted = following
        reason = "" if following.fit.kind == "exponential and temperature" else see_next(following.fit)
    return WarmupReport(
        channel, first, reason, following, accepted, age, times, means, grades, record, tuple(notes)
    )


def _block_means(
    record: EvenGrid, t: FloatArray, temperature: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Times, means of the samples present and of the temperature, in at most some thousand blocks."""
    size = max(1, len(record.values) // _MEANS)
    blocks = len(record.values) // size
    count = blocks * size
    held = record.present[:count].reshape(blocks, size).sum(axis=1)
    kept = 2 * held >= size
    sums = np.where(record.present, record.values, 0.0)[:count].reshape(blocks, size).sum(axis=1)
    times = record.start + (np.arange(blocks) + 0.5) * size * record.dt
    grades = None if temperature is None else np.interp(times[kept], t, temperature)
    return times[kept], sums[kept] / held[kept], grades


def _not_earned(fit: WarmupFit, times: FloatArray, means: FloatArray) -> str:
    """Why c1 and the time constant cannot be given, "" when they can."""
    c1, constant = fit.values["c1"], fit.values["time_constant"]
    duration = float(times[-1] - times[0])
    wander = _wander(fit, duration)
    change = abs(c1 * math.expm1(-duration / constant))
    spread = fit.noise**2 * fit.widened
    flat = (float(np.sum((means - means.mean()) ** 2)) - float(fit.residual @ fit.residual)) / spread
    # Two parameters more than a constant, the time constant searched for over decades: five sigma.
    if change < _SIGNIFICANT * wander or flat < 25.0:
        return (
            f"no warm-up stands out: the bias wanders by {math.degrees(wander):.2g} deg/s in itself over "
            "the record; a "
            f"warm-up, if there is one, changes it by less than {math.degrees(change + 2 * wander):.2g} deg/s"
        )
    # A time constant beyond the record is a straight line: the curve must be better than that by four sigma.
    line = np.polynomial.Polynomial.fit(times, means, 1)
    bend = float(np.sum((means - line(times)) ** 2) - fit.residual @ fit.residual) / spread
    if bend > _SIGNIFICANT**2 and fit.determined:
        return ""
    if duration > 3.0 * constant:
        return (
            f"a curve is there, but noise hides its time constant ({constant:.3g} s, sigma "
            f"{fit.sigma['time_constant']:.3g} s): keep more samples per second of the same standstill"
        )
    return (
        f"the record of {duration:.4g} s shows a drift but not its end: c1 and the time constant cannot be "
        "told apart "
        f"(time constant {constant:.3g} s, sigma {fit.sigma['time_constant']:.3g} s); record from power-on "
        f"for {3 * max(constant, duration):.2g} s or more"
    )


def _wander(fit: WarmupFit, duration: float) -> float:
    """What the bias changes by over the record without any warm-up, rad/s: noise of the means, and a walk."""
    tenths = [part.mean() for part in np.array_split(fit.residual, 10)]
    steps = float(np.mean(np.diff(tenths) ** 2))
    return math.sqrt(steps * (10.0 if fit.widened > 1.0 else 1.0))
