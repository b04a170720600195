"""The reference of a gyro axis: a column of another table, aligned in time, scale and offset."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.recording import Recording, Table

MAX_DELAY_S = 1.0
"""Largest delay searched for, s; clocks of one log agree better."""
_DELAY_SMOOTHING_S = 0.1
"""Standard deviation of the smoothing before delays are measured, s; vehicles change speed slowly."""
_ANGLE_COLUMNS = ("angle", "heading")
"""Columns in rad, whose slope is the rate."""
_SPEED_COLUMNS = ("left", "right", "speed")
"""Columns in m/s, which a wheel radius converts to a rate."""
_MIN_REFERENCE_ROWS = 32
_MIN_CORRELATION = 0.5
"""Correlation below which the reference does not show the rotation of this axis."""


@dataclass(frozen=True)
class Reference:
    """The rate of a gyro axis according to another sensor.

    Attributes:
        name: table and column.
        t: (M,) s.
        rate: (M,) in the unit of the sensor, or rad/s after `align_reference`.
        scale: rad/s per unit of the sensor's rate.
        offset: rad/s, gyro minus reference.
        delay: s by which the sensor lags the gyro; it is removed.
    """

    name: str
    t: Array
    rate: Array
    scale: float = 1.0
    offset: float = 0.0
    delay: float = 0.0


def read_reference(recording: Recording, text: str, node: str, channel: str) -> Reference:
    """Return the reference named TABLE or TABLE.COLUMN, such as `wheels`, `table` or `frame.gz`.

    Raises InputError if the log lacks the table or the column.
    """
    table_name, _, column = text.partition(".")
    tables = recording.files()
    if table_name not in tables or table_name == node:
        others = [name for name in tables if name != node]
        raise InputError(f"--reference {text}: the log has {', '.join(others) or 'no other table'}")
    table = tables[table_name]
    column = column or _default_column(table, node, channel)
    if column not in table or column == "t":
        available = ", ".join(f"{table_name}.{name}" for name in table if name != "t")
        raise InputError(f"--reference {text}: name the column: {available}")
    values = table[column]
    known = np.isfinite(values)
    t, values = table.t[known], values[known]
    if len(t) < _MIN_REFERENCE_ROWS:
        raise InputError(f"--reference {text}: {len(t)} rows are too few for a reference")
    if column in _ANGLE_COLUMNS:
        slopes = np.diff(np.unwrap(values)) / np.diff(t)
        t, values = 0.5 * (t[1:] + t[:-1]), slopes
    return Reference(f"{table_name}.{column}", t, np.asarray(values, np.float64))


def _default_column(table: Table, node: str, channel: str) -> str:
    """Return the column of the node's wheel, of the same channel, or the only one that gives a rate."""
    candidates = (node, channel, "angle", "speed", "heading")
    return next((name for name in candidates if name in table and name != "t"), "")


def align_reference(reference: Reference, t: Array, samples: Array, dt: float) -> Reference:
    """Return the reference with delay, scale and offset fitted to samples (N,) rad/s at times t, s.

    The scale converts a surface speed without a wheel radius, and removes the scale error of the gyro, which
    is common to all filters. Raises InputError if the two have too little in common.
    """
    inside = (t >= reference.t[0]) & (t <= reference.t[-1])
    if np.count_nonzero(inside) < _MIN_REFERENCE_ROWS:
        raise InputError(f"{reference.name} has no values during the samples; check the clocks of the log")
    t, samples = t[inside], samples[inside]
    at_samples = np.interp(t, reference.t, reference.rate)
    delay = measure_delay(at_samples, samples, dt)
    if math.isnan(delay):
        raise InputError(
            f"{reference.name} and the samples do not match within {MAX_DELAY_S:g} s; check the clocks of "
            "the log"
        )
    values = np.interp(t + delay, reference.t, reference.rate)
    columns = np.column_stack([values, np.ones(len(values))])
    scale, offset = np.linalg.lstsq(columns, samples, rcond=None)[0].tolist()
    spread = float(np.std(values) * np.std(samples))
    correlation = float(np.cov(values, samples)[0, 1]) / spread if spread else 0.0
    if abs(correlation) < _MIN_CORRELATION:
        raise InputError(
            f"{reference.name} does not show the rotation of this axis (correlation {correlation:.2f}); "
            "choose another --channel or --reference"
        )
    return replace(
        reference,
        t=reference.t - delay,
        rate=reference.rate * scale,
        scale=scale,
        offset=offset,
        delay=delay,
    )


def measure_delay(delayed: Array, source: Array, dt: float) -> float:
    """Return the lag, s, of `delayed` (N,) behind `source` (N,), from their cross-correlation.

    Both are smoothed without delay, since noise common to both would put the peak at zero. The peak of the
    magnitude is interpolated by a parabola; NaN without a peak within `MAX_DELAY_S`. dt: s.
    """
    from scipy.ndimage import gaussian_filter1d  # scipy.signal takes half a second to import
    from scipy.signal import correlate

    count = len(source)
    reach = min(max(2, round(MAX_DELAY_S / dt)), count // 4)
    width = max(_DELAY_SMOOTHING_S / dt, 3.0)
    delayed, source = gaussian_filter1d(delayed, width), gaussian_filter1d(source, width)
    # Correlate the interior of the source with equally long parts of the other signal, each normalised by its
    # own standard deviation.
    part = source[reach : count - reach]
    part = part - part.mean()
    sums, squares = (
        np.concatenate([[0.0], np.cumsum(powers)]) for powers in (delayed, (delayed - delayed.mean()) ** 2)
    )
    sums = sums - delayed.mean() * np.arange(count + 1)
    spread = squares[len(part) :] - squares[: -len(part)]
    spread = spread - (sums[len(part) :] - sums[: -len(part)]) ** 2 / len(part)
    products = correlate(delayed - delayed.mean(), part, mode="valid", method="fft")
    values = np.abs(products) / np.sqrt(np.maximum(spread, 1e-12 * squares[-1] + 1e-300))
    best = int(values.argmax())
    if not 0 < best < len(values) - 1:
        return math.nan
    before, peak, after = values[best - 1 : best + 2]
    curvature = before - 2.0 * peak + after
    fraction = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
    return float(best - reach + fraction) * dt


def unit_of_scale(reference: Reference) -> str:
    """Return the unit of `Reference.scale`."""
    return "rad/m" if reference.name.rpartition(".")[2] in _SPEED_COLUMNS else ""
