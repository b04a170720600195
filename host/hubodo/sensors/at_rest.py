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
_ACCEL_RANGE = (8.5, 11.2)
_BLOCK_S = 1.0
_MOVED_SIGMAS = 10.0
_STEP_WINDOW_S, _STEP_DEGREES = 60.0, 1.5

_ACCEL_UNITS = ((0.85, 1.15, "g"), (850.0, 1150.0, "mg"), (85.0, 112.0, "dm/s²"), (850e3, 1150e3, "µg"))


@dataclass(frozen=True)
class TemperatureStep:
    """A jump of the temperature record: time of its onset in s, change over the next minute in degrees."""

    t: float
    change: float


def check_units(gyro: FloatArray | None, accel: FloatArray | None) -> None:
    """Refuse rates and specific forces that no sensor at rest shows in rad/s and m/s².

    gyro, accel: (N, 3) or None when not measured. Raises InputError that names the unit it looks like.
    """
    if accel is not None and len(accel):
        size = float(np.median(np.linalg.norm(accel, axis=1)))
        if size > 0 and not _ACCEL_RANGE[0] <= size <= _ACCEL_RANGE[1]:
            guess = next((f"{unit}" for low, high, unit in _ACCEL_UNITS if low <= size <= high), None)
            what = f"that is {guess}" if guess else "raw counts" if _whole_numbers(accel) else "no known unit"
            raise InputError(
                f"the accelerometer at rest reads {size:.4g}, gravity is 9.8 m/s²: {what}; convert the "
                "record to SI "
                "before import (and check the gyro's unit), or say --trust-units"
            )
    if gyro is not None and len(gyro):
        noise = float(np.max(np.std(np.diff(gyro, axis=0), axis=0))) / math.sqrt(2.0)
        offset = float(np.max(np.abs(np.median(gyro, axis=0))))
        if noise > _GYRO_NOISE or offset > _GYRO_OFFSET:
            if _whole_numbers(gyro):
                guess = "these are whole numbers, raw counts"
            elif noise > 30 * _GYRO_NOISE or offset > 60 * _GYRO_OFFSET:
                guess = "it looks like mdeg/s, or like a sensor that turns"
            else:
                guess = "it looks like deg/s, or like a sensor that turns"
            raise InputError(
                f"the gyro at rest reads offset {offset:.3g} and noise {noise:.3g} per sample: too much for "
                f"rad/s, {guess}; convert the record to rad/s, keep the sensor still, or say --trust-units"
            )


def moved(t: FloatArray, values: FloatArray) -> tuple[float, float] | None:
    """First stretch (start, end in s) in which a sensor that should be still was moved, None when it was not.

    t: (N,) s. values: (N, C) gyro and accelerometer columns. Means over a second step from one to the next by
    noise and drift alone, which have one scale; a step of ten of these, or a second as much noisier, is
    movement.
    """
    size = max(8, round(_BLOCK_S * (len(t) - 1) / (t[-1] - t[0])))
    blocks = len(t) // size
    if blocks < 12:
        return None
    cut = values[: blocks * size].reshape(blocks, size, -1)
    # A quiet channel behind a coarse converter hardly ever changes: half a step then stands for its noise.
    changes = np.abs(np.diff(values[: min(len(values), 20_000)], axis=0))
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
    if not len(found):
        return None
    breaks = np.flatnonzero(np.diff(found) > 5)
    last = int(found[breaks[0]]) if len(breaks) else int(found[-1])
    return float(t[int(found[0]) * size]), float(t[min((last + 2) * size, len(t) - 1)])


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
