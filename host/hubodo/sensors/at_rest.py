"""Whether a record can be a sensor at rest in SI units: magnitude, movement, temperature."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError

FloatArray = NDArray[np.float64]

# A gyro at rest: rate noise of the worst MEMS part at its full bandwidth, and the worst zero-rate offset.
_GYRO_NOISE, _GYRO_OFFSET = 0.03, 0.35
# rad/√s, 10 °/√h: three times the white noise of the noisiest MEMS parts on sale (0.05 °/s/√Hz).
_GYRO_WHITE = 3e-3
_ACCEL_RANGE = (8.5, 11.2)
_BLOCK_S = 1.0
_MOVED_SIGMAS = 10.0
_MOST_LOST, _LEVEL_S = 0.25, 10.0
_STEP_WINDOW_S, _STEP_DEGREES = 60.0, 1.5
_MOST_EMPTY = 100

_ACCEL_UNITS = ((0.85, 1.15, "g"), (850.0, 1150.0, "mg"), (85.0, 112.0, "dm/s²"), (850e3, 1150e3, "µg"))


@dataclass(frozen=True)
class TemperatureStep:
    """A jump of the temperature record: time of its onset in s, change over the next minute in degrees."""

    t: float
    change: float


def check_units(gyro: FloatArray | None, accel: FloatArray | None, interval: float | None = None) -> None:
    """Refuse rates and specific forces that no sensor at rest shows in rad/s and m/s².

    gyro, accel: (N, C) or None when not measured, columns that are not finite are passed over; interval: of
    the samples, s, by which the white noise of a gyro is judged too. Raises InputError that names the unit
    it looks like.
    """
    if accel is not None and len(accel) and accel.shape[1] == 3 and np.isfinite(accel).all():
        _check_accel(accel)
    if gyro is not None and len(gyro):
        measured = np.isfinite(gyro).all(axis=0)
        if measured.any():
            _check_gyro(gyro[:, measured], interval)


def _check_accel(accel: FloatArray) -> None:
    size = float(np.median(np.linalg.norm(accel, axis=1)))
    if size > 0 and not _ACCEL_RANGE[0] <= size <= _ACCEL_RANGE[1]:
        guess = next((unit for low, high, unit in _ACCEL_UNITS if low <= size <= high), None)
        what = f"that is {guess}" if guess else "raw counts" if _whole_numbers(accel) else "no known unit"
        raise InputError(
            f"the accelerometer at rest reads {size:.4g}, gravity is 9.8 m/s²: {what}; say its unit "
            "with --unit (and check the gyro's), convert the record to SI, or say --trust-units"
        )


def _check_gyro(gyro: FloatArray, interval: float | None) -> None:
    # What nine of ten differences stay within: a knock is not noise, and coarse steps are.
    steps = np.quantile(np.abs(np.diff(gyro, axis=0)), 0.9, axis=0)
    noise = float(np.max(steps)) / 1.645 / math.sqrt(2.0)
    offset = float(np.max(np.abs(np.median(gyro, axis=0))))
    white = 0.0 if interval is None else white_noise(gyro, interval)
    if noise <= _GYRO_NOISE and offset <= _GYRO_OFFSET and white <= _GYRO_WHITE:
        return
    if _whole_numbers(gyro):
        guess = "these are whole numbers, raw counts"
    elif noise > 30 * _GYRO_NOISE or offset > 60 * _GYRO_OFFSET or white > 30 * _GYRO_WHITE:
        guess = "it looks like mdeg/s, or like a sensor that turns"
    else:
        guess = "it looks like deg/s, or like a sensor that turns"
    walk = "" if white == 0.0 else f", an angle random walk of {math.degrees(white) * 60.0:.3g} °/√h"
    raise InputError(
        f"the gyro at rest reads offset {offset:.3g} and noise {noise:.3g} per sample{walk}: too much for "
        f"rad/s, {guess}; say --unit deg/s or what it is, keep the sensor still, or say --trust-units"
    )


def white_noise(gyro: FloatArray, interval: float) -> float:
    """rad/√s: the largest white noise of the columns, (N, C), by neighbouring means of a quarter second."""
    size = max(1, round(0.25 / interval))
    blocks = len(gyro) // size
    if blocks < 16:
        return 0.0
    means = gyro[: blocks * size].reshape(blocks, size, gyro.shape[1]).mean(axis=1)
    # The median of the differences: single knocks do not count.
    steps = np.median(np.abs(np.diff(means, axis=0)), axis=0) / 0.6745
    return float(np.max(steps)) * math.sqrt(0.5 * size * interval)


def disturbed(t: FloatArray, values: FloatArray) -> list[tuple[float, float]]:
    """Stretches (start, end in s) in which a sensor that should be still was moved, in order of time.

    t: (N,) s. values: (N, C) gyro and accelerometer columns. Means over a second step from one to the next by
    noise and drift alone, which have one scale; a step of ten of these, or a second as much noisier, is
    movement. What lies between two of them within five seconds belongs to them.
    """
    size = max(8, round(_BLOCK_S * (len(t) - 1) / (t[-1] - t[0])))
    blocks = len(t) // size
    if blocks < 12:
        return []
    cut = values[: blocks * size].reshape(blocks, size, values.shape[1])
    # A quiet channel behind a coarse converter hardly ever changes: half a step then stands for its noise.
    changes = np.abs(np.diff(values[:20_000], axis=0))
    coarse = 0.5 * np.min(changes, axis=0, initial=np.inf, where=changes > 0)
    typical = np.maximum(np.median(np.std(cut, axis=1), axis=0), np.where(np.isfinite(coarse), coarse, 1e-12))
    # Single outliers are no movement: they are cut down to where noise ends.
    middle = np.median(cut, axis=1, keepdims=True)
    cut = np.clip(cut, middle - 6.0 * typical, middle + 6.0 * typical)
    means, spreads = np.mean(cut, axis=1), np.std(cut, axis=1)
    steps = np.abs(np.diff(means, axis=0))
    scale = np.maximum(1.4826 * np.median(steps, axis=0), typical / math.sqrt(size))
    jump = np.concatenate((np.any(steps > _MOVED_SIGMAS * scale, axis=1), [False]))
    wild = np.any(spreads > 2.0 * typical * (1.0 + 6.0 / math.sqrt(2.0 * size)), axis=1)
    found = np.flatnonzero(jump | wild)
    groups = np.split(found, np.flatnonzero(np.diff(found) > 5) + 1) if len(found) else []
    return [
        (float(t[group[0] * size]), float(t[min((group[-1] + 2) * size, len(t) - 1)])) for group in groups
    ]


def rest_of(t: FloatArray, values: FloatArray, channel: FloatArray) -> list[tuple[float, float]]:
    """What has to be cut out of a record at rest: what is disturbed, and what is at another level in between.

    channel: (N,) the column that the rest is for. A sensor that is turned for a minute is quiet meanwhile
    and reads another rate: such a part goes with the disturbances around it. Raises InputError where more
    than a quarter would go.
    """
    spans = disturbed(t, values)
    if not spans:
        return []
    spans = _with_other_levels(t, channel, spans)
    lost = sum(end - begin for begin, end in spans) / float(t[-1] - t[0])
    if lost > _MOST_LOST:
        raise InputError(
            f"the sensor was moved in {len(spans)} stretches, {lost:.0%} of the record, the first from "
            f"{spans[0][0]:.6g} s to {spans[0][1]:.6g} s: too much to cut out; take a part at rest with "
            "--start and --end, or say --as-is"
        )
    return spans


def _with_other_levels(
    t: FloatArray, channel: FloatArray, spans: list[tuple[float, float]]
) -> list[tuple[float, float]]:
    """The spans, and the parts between them in which the channel is not where it was before and is after."""
    ends = [float(t[0]), *(edge for span in spans for edge in span), float(t[-1])]
    parts = [(ends[k], ends[k + 1]) for k in range(0, len(ends), 2)]
    rows = [slice(*np.searchsorted(t, part)) for part in parts]
    sizes = [row.stop - row.start for row in rows]
    first, last = [np.nan] * len(parts), [np.nan] * len(parts)
    interval = float(t[-1] - t[0]) / len(t)
    near = max(8, round(_LEVEL_S / interval))
    for k, row in enumerate(rows):
        if sizes[k] >= 8:
            first[k] = float(np.mean(channel[row][:near]))
            last[k] = float(np.mean(channel[row][-near:]))
    longest = int(np.argmax(sizes))
    body = channel[rows[longest]]
    blocks = body[: len(body) // near * near].reshape(-1, near).mean(axis=1)
    scale = 1.4826 * float(np.median(np.abs(np.diff(blocks)))) if len(blocks) > 2 else float(np.std(body))
    kept = list(spans)
    for way in (1, -1):
        before, k = longest, longest + way
        while 0 <= k < len(parts):
            edges = (last[before], first[k]) if way > 0 else (first[before], last[k])
            if sizes[k] < 8 or abs(edges[0] - edges[1]) > _MOVED_SIGMAS * scale:
                kept.append(parts[k])
            else:
                before = k
            k += way
    return _merged(kept)


def _merged(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """In order, touching ones as one."""
    made: list[tuple[float, float]] = []
    for begin, end in sorted(spans):
        if made and begin <= made[-1][1]:
            made[-1] = (made[-1][0], max(end, made[-1][1]))
        else:
            made.append((begin, end))
    return made


def moved(t: FloatArray, values: FloatArray) -> tuple[float, float] | None:
    """The first stretch that `disturbed` finds, None where nothing moved."""
    return next(iter(disturbed(t, values)), None)


def check_still(t: FloatArray, values: FloatArray) -> None:
    """Raises InputError with the time when the sensor was moved; see `moved`."""
    when = moved(t, values)
    if when is not None:
        raise InputError(
            f"the sensor was moved between {when[0]:.6g} s and {when[1]:.6g} s: its own noise cannot be "
            "told from "
            f"that; take a part at rest with --start and --end (here --end {when[0]:.6g} or --start "
            f"{when[1]:.6g})"
        )


def temperature_step(t: FloatArray, temperature: FloatArray) -> TemperatureStep | None:
    """The largest jump: more than 1.5 degrees within a minute, and four times what the minute before did."""
    if t[-1] - t[0] > 5.0 * _MOST_EMPTY * len(t):
        return None  # but for a wild stamp there is nothing on most of it
    grid = np.arange(t[0], t[-1], 5.0)
    half = round(_STEP_WINDOW_S / 5.0)
    if len(grid) < 3 * half:
        return None
    places = np.searchsorted(t, grid)
    sums = np.concatenate(([0.0], np.cumsum(temperature - temperature[0])))
    width = np.diff(np.append(places, len(t)))
    values = np.diff(sums[np.append(places, len(t))]) / np.maximum(width, 1)
    values = np.interp(grid, grid[width > 0], values[width > 0])
    change = values[2 * half :] - values[half:-half]
    before = values[half:-half] - values[: -2 * half]
    jumps = np.where(
        (np.abs(change) > _STEP_DEGREES) & (np.abs(change) > 4.0 * np.abs(before)), np.abs(change), 0.0
    )
    if not jumps.any():
        return None
    place = int(np.argmax(jumps))
    return TemperatureStep(float(grid[place + half]), float(change[place]))


def _whole_numbers(values: FloatArray) -> bool:
    part = values[:2000]
    return bool(np.all(part == np.rint(part))) and float(np.max(np.abs(part))) >= 1.0
