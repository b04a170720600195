"""Checks that a record comes from a stationary sensor in SI units: magnitude, motion, temperature steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.frozen_readings import find_frozen_spans

# rad/s: noise per sample (1 sigma) of the noisiest MEMS gyros at full bandwidth, and their largest
# zero-rate offset.
_MAX_GYRO_NOISE, _MAX_GYRO_OFFSET = 0.03, 0.35
# rad/√s, 10 °/√h: three times the white noise of the noisiest MEMS parts on sale (0.05 °/s/√Hz).
_MAX_ANGLE_RANDOM_WALK = 3e-3
# s: shortest and longest sample interval of gyros, and the shortest one that may be in another unit.
_MIN_INTERVAL, _MAX_INTERVAL, _MIN_SUSPECT_INTERVAL = 5e-5, 0.2, 0.5
_GRAVITY_RANGE = (8.5, 11.2)
_MOTION_BLOCK_S = 1.0
_MOTION_SIGMA = 10.0
_MAX_OUTLIERS, _MAX_OUTLIER_SHARE = 3, 0.1  # in one second
_MAX_CUT_FRACTION, _LEVEL_MEAN_S = 0.25, 10.0
_TEMPERATURE_WINDOW_S, _MIN_TEMPERATURE_STEP = 60.0, 1.5
_MAX_GRID_PER_SAMPLE = 100

_ACCEL_UNITS = ((0.85, 1.15, "g"), (850.0, 1150.0, "mg"), (85.0, 112.0, "dm/s²"), (850e3, 1150e3, "µg"))


@dataclass(frozen=True)
class TemperatureStep:
    """A step of the temperature record: t, time of its onset in s; change over the next minute in °C."""

    t: float
    change: float


def check_units(gyro: Array | None, accel: Array | None, interval: float | None = None) -> None:
    """Raise InputError if the samples cannot be those of a stationary sensor in rad/s and m/s².

    gyro, accel: (N, C), or None if not measured; columns that are not finite are skipped. interval: sample
    interval, s; with it, the white noise of the gyro is checked too. The error names the likely unit.
    """
    if accel is not None and len(accel) and accel.shape[1] == 3 and np.isfinite(accel).all():
        _check_accel(accel)
    if gyro is not None and len(gyro):
        measured = np.isfinite(gyro).all(axis=0)
        if measured.any():
            _check_gyro(gyro[:, measured], interval)


def _check_accel(accel: Array) -> None:
    size = float(np.median(np.linalg.norm(accel, axis=1)))
    if size > 0 and not _GRAVITY_RANGE[0] <= size <= _GRAVITY_RANGE[1]:
        guess = next((unit for low, high, unit in _ACCEL_UNITS if low <= size <= high), None)
        what = f"that is {guess}" if guess else "raw counts" if _are_whole_numbers(accel) else "no known unit"
        raise InputError(
            f"the stationary accelerometer reads {size:.4g}, gravity is 9.8 m/s²: {what}; give its unit "
            "with --unit (and check the gyro's), convert the record to SI, or use --trust-units"
        )


def _check_gyro(gyro: Array, interval: float | None) -> None:
    # The 90 % quantile of the differences is robust against single knocks but includes coarse quantisation
    # steps.
    steps = np.quantile(np.abs(np.diff(gyro, axis=0)), 0.9, axis=0)
    noise = float(np.max(steps)) / 1.645 / math.sqrt(2.0)
    offset = float(np.max(np.abs(np.median(gyro, axis=0))))
    white = 0.0 if interval is None else angle_random_walk(gyro, interval)
    if noise <= _MAX_GYRO_NOISE and offset <= _MAX_GYRO_OFFSET and white <= _MAX_ANGLE_RANDOM_WALK:
        return
    if interval is not None:
        _check_rest(gyro, interval, noise)
        if noise <= _MAX_GYRO_NOISE and offset <= _MAX_GYRO_OFFSET:
            _check_time_unit(gyro, interval)
    if _are_whole_numbers(gyro):
        guess = "these are whole numbers, raw counts"
    elif (
        noise > 30 * _MAX_GYRO_NOISE or offset > 60 * _MAX_GYRO_OFFSET or white > 30 * _MAX_ANGLE_RANDOM_WALK
    ):
        guess = "it looks like mdeg/s, or like a sensor that turns"
    else:
        guess = "it looks like deg/s, or like a sensor that turns"
    walk = "" if white == 0.0 else f", an angle random walk of {math.degrees(white) * 60.0:.3g} °/√h"
    raise InputError(
        f"the stationary gyro has offset {offset:.3g} and noise {noise:.3g} per sample{walk}: too much for "
        f"rad/s, {guess}; give its unit (--unit deg/s), keep the sensor still, or use --trust-units"
    )


def _check_rest(gyro: Array, interval: float, noise: float) -> None:
    """Raise InputError if the rate changes from second to second, in any unit: the sensor turns.

    noise: standard deviation of one sample, in the unit of the record.
    """
    size = max(1, round(_MOTION_BLOCK_S / interval))
    blocks = len(gyro) // size
    if blocks < 4:
        return
    means = gyro[: blocks * size].reshape(blocks, size, gyro.shape[1]).mean(axis=1)
    change = float(np.max(np.median(np.abs(np.diff(means, axis=0)), axis=0)))
    expected = noise * math.sqrt(2.0 / size)
    if size > 1 and change > _MOTION_SIGMA * expected:
        raise InputError(
            f"this record is not at rest: the rate changes by {change:.3g} from one second to the next, "
            f"noise makes {expected:.2g}; select a stationary part with --start and --end"
        )


def _check_time_unit(gyro: Array, interval: float) -> None:
    """Raise InputError if the noise is that of a gyro sampled a thousand (million, ...) times faster."""
    if interval < _MIN_SUSPECT_INTERVAL:
        return
    for name, factor in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        true_interval = interval * factor
        if not _MIN_INTERVAL <= true_interval <= _MAX_INTERVAL:
            continue
        if angle_random_walk(gyro, true_interval) <= _MAX_ANGLE_RANDOM_WALK:
            raise InputError(
                f"the samples are {interval:.4g} s apart, too much for noise that small: the times look like "
                f"{name}; name their column t_{name} (--columns t_{name},gz), or give the unit of the rate "
                "with --unit if the times are in s"
            )


def angle_random_walk(gyro: Array, interval: float) -> float:
    """Return the largest angle random walk, rad/√s, of the columns (N, C), from adjacent 0.25 s means."""
    size = max(1, round(0.25 / interval))
    blocks = len(gyro) // size
    if blocks < 16:
        return 0.0
    means = gyro[: blocks * size].reshape(blocks, size, gyro.shape[1]).mean(axis=1)
    # The median of the differences is robust against single knocks.
    steps = np.median(np.abs(np.diff(means, axis=0)), axis=0) / 0.6745
    return float(np.max(steps)) * math.sqrt(0.5 * size * interval)


def find_disturbances(t: Array, values: Array) -> list[tuple[float, float]]:
    """Return the time spans (start, end in s), in order, in which a supposedly stationary sensor was moved.

    t: (N,) s. values: (N, C) gyro and accelerometer columns. The differences of successive one-second
    means come from noise and drift and have a common scale; a difference of ten times that scale, or a
    second with significantly more noise, counts as motion. Disturbances less than five seconds apart are
    joined.
    """
    size = max(8, round(_MOTION_BLOCK_S * (len(t) - 1) / (t[-1] - t[0])))
    blocks = len(t) // size
    if blocks < 12:
        return []
    block_samples = values[: blocks * size].reshape(blocks, size, values.shape[1])
    # A quiet channel with coarse quantisation rarely changes; its noise is then taken as half a
    # quantisation step.
    changes = np.abs(np.diff(values[:20_000], axis=0))
    coarse = 0.5 * np.min(changes, axis=0, initial=np.inf, where=changes > 0)
    typical = np.maximum(
        np.median(np.std(block_samples, axis=1), axis=0), np.where(np.isfinite(coarse), coarse, 1e-12)
    )
    # Single outliers are not motion, so samples are clipped at 6 sigma; several of them in a second are.
    middle = np.median(block_samples, axis=1, keepdims=True)
    outliers = np.count_nonzero(np.abs(block_samples - middle) > 6.0 * typical, axis=1)
    kicked = np.any(outliers > max(_MAX_OUTLIERS, _MAX_OUTLIER_SHARE * size), axis=1)
    block_samples = np.clip(block_samples, middle - 6.0 * typical, middle + 6.0 * typical)
    means, spreads = np.mean(block_samples, axis=1), np.std(block_samples, axis=1)
    steps = np.abs(np.diff(means, axis=0))
    scale = np.maximum(1.4826 * np.median(steps, axis=0), typical / math.sqrt(size))
    jump = np.concatenate((np.any(steps > _MOTION_SIGMA * scale, axis=1), [False]))
    noisy = np.any(spreads > 2.0 * typical * (1.0 + 6.0 / math.sqrt(2.0 * size)), axis=1)
    disturbed_blocks = np.flatnonzero(jump | noisy | kicked)
    groups = (
        np.split(disturbed_blocks, np.flatnonzero(np.diff(disturbed_blocks) > 5) + 1)
        if len(disturbed_blocks)
        else []
    )
    return [
        (float(t[group[0] * size]), float(t[min((group[-1] + 2) * size, len(t) - 1)])) for group in groups
    ]


def find_cuts(t: Array, values: Array, channel: Array) -> list[tuple[float, float]]:
    """Return the time spans (start, end in s) to cut: disturbances, frozen readings and shifted segments.

    channel: (N,) the column to be analysed. A sensor that is turned to another pose for a minute is quiet in
    between but has another mean; such a segment is cut together with the disturbances around it. Raises
    InputError if more than a quarter of the record would be cut.
    """
    spans = _merge_spans([*find_disturbances(t, values), *find_frozen_spans(t, channel)])
    if not spans:
        return []
    spans = _add_shifted_segments(t, channel, spans)
    cut_fraction = sum(end - start for start, end in spans) / float(t[-1] - t[0])
    if cut_fraction > _MAX_CUT_FRACTION:
        raise InputError(
            f"the sensor was moved or frozen in {len(spans)} stretches, {cut_fraction:.0%} of the record, "
            f"first from {spans[0][0]:.6g} s to {spans[0][1]:.6g} s: too much to cut out; select another "
            "part with --start and --end, or use --as-is"
        )
    return spans


def _add_shifted_segments(
    t: Array, channel: Array, spans: list[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return the spans and the segments between them whose level differs from the longest segment."""
    ends = [float(t[0]), *(edge for span in spans for edge in span), float(t[-1])]
    parts = [(ends[k], ends[k + 1]) for k in range(0, len(ends), 2)]
    rows = [slice(*np.searchsorted(t, part)) for part in parts]
    sizes = [row.stop - row.start for row in rows]
    first, last = [np.nan] * len(parts), [np.nan] * len(parts)
    interval = float(t[-1] - t[0]) / len(t)
    level_samples = max(8, round(_LEVEL_MEAN_S / interval))
    for k, row in enumerate(rows):
        if sizes[k] >= 8:
            first[k] = float(np.mean(channel[row][:level_samples]))
            last[k] = float(np.mean(channel[row][-level_samples:]))
    longest = int(np.argmax(sizes))
    body = channel[rows[longest]]
    blocks = body[: len(body) // level_samples * level_samples].reshape(-1, level_samples).mean(axis=1)
    scale = 1.4826 * float(np.median(np.abs(np.diff(blocks)))) if len(blocks) > 2 else float(np.std(body))
    cuts = list(spans)
    for direction in (1, -1):
        reference, k = longest, longest + direction
        while 0 <= k < len(parts):
            edges = (last[reference], first[k]) if direction > 0 else (first[reference], last[k])
            if sizes[k] < 8 or abs(edges[0] - edges[1]) > _MOTION_SIGMA * scale:
                cuts.append(parts[k])
            else:
                reference = k
            k += direction
    return _merge_spans(cuts)


def _merge_spans(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the spans in order, with overlapping and adjacent ones merged."""
    merged: list[tuple[float, float]] = []
    for start, end in sorted(spans):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged


def first_disturbance(t: Array, values: Array) -> tuple[float, float] | None:
    """Return the first span of `find_disturbances`, or None if the sensor did not move."""
    return next(iter(find_disturbances(t, values)), None)


def check_standstill(t: Array, values: Array) -> None:
    """Raise InputError with the time at which the sensor was moved, if it was; see `find_disturbances`."""
    span = first_disturbance(t, values)
    if span is not None:
        raise InputError(
            f"the sensor was moved between {span[0]:.6g} s and {span[1]:.6g} s, which hides its own noise; "
            f"select a stationary part with --start and --end (here --end {span[0]:.6g} or --start "
            f"{span[1]:.6g})"
        )


def find_temperature_step(t: Array, temperature: Array) -> TemperatureStep | None:
    """Return the largest temperature step, or None.

    t: (N,) s. temperature: (N,) °C. A step is a change of more than 1.5 °C within a minute that is at
    least four times the change during the minute before.
    """
    if t[-1] - t[0] > 5.0 * _MAX_GRID_PER_SAMPLE * len(t):
        return None  # a corrupt time stamp leaves most of the grid empty
    grid = np.arange(t[0], t[-1], 5.0)
    half = round(_TEMPERATURE_WINDOW_S / 5.0)
    if len(grid) < 3 * half:
        return None
    starts = np.searchsorted(t, grid)
    sums = np.concatenate(([0.0], np.cumsum(temperature - temperature[0])))
    width = np.diff(np.append(starts, len(t)))
    values = np.diff(sums[np.append(starts, len(t))]) / np.maximum(width, 1)
    values = np.interp(grid, grid[width > 0], values[width > 0])
    change = values[2 * half :] - values[half:-half]
    before = values[half:-half] - values[: -2 * half]
    jumps = np.where(
        (np.abs(change) > _MIN_TEMPERATURE_STEP) & (np.abs(change) > 4.0 * np.abs(before)),
        np.abs(change),
        0.0,
    )
    if not jumps.any():
        return None
    index = int(np.argmax(jumps))
    return TemperatureStep(float(grid[index + half]), float(change[index]))


def _are_whole_numbers(values: Array) -> bool:
    part = values[:2000]
    return bool(np.all(part == np.rint(part))) and float(np.max(np.abs(part))) >= 1.0
