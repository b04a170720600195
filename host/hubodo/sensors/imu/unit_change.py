"""Change of the unit of a sensor within a record, as in files joined from two loggers."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.errors import InputError

_WINDOW, _BLOCKS, _MIN_WINDOWS = 16, 16, 4
"""Samples of a window, blocks of a record, and the smallest number of windows of a block."""
_QUIET_SHARE = 0.2
"""The quietest fifth of the windows of a block is at standstill, and shows the noise alone."""
_LOUD_SHARE, _SIZE_TOLERANCE = 0.9, math.log(3.0)
"""Another unit changes the rates of the turns too, vibration does not."""
_MIN_SIDE = 2
"""Blocks on either side of a change."""
_GYRO_FACTORS = {math.degrees(1.0): "rad/s and deg/s", 1e3 * math.degrees(1.0): "rad/s and mdeg/s"}
_ACCEL_FACTORS = {STANDARD_GRAVITY: "g and m/s²", 1e3 / STANDARD_GRAVITY: "m/s² and mg", 1e3: "g and mg"}
_NOISE_TOLERANCE, _GRAVITY_TOLERANCE = math.log(1.6), math.log(1.2)


def check_one_unit(t: Array, gyro: Array, accel: Array) -> None:
    """Raise InputError with the time at which the noise of the gyros or gravity changes by a factor of units.

    t: (N,) s. gyro, accel: (N, 3); rows that are not finite are ignored.
    """
    rows = np.isfinite(gyro).all(axis=1)
    noise = np.linalg.norm(np.diff(gyro[rows], axis=0), axis=1)
    rate = np.linalg.norm(gyro[rows][1:], axis=1)
    _check("gyros' noise", t[rows][1:], noise, rate, _QUIET_SHARE, _GYRO_FACTORS, _NOISE_TOLERANCE)
    rows = np.isfinite(accel).all(axis=1)
    norm = np.linalg.norm(accel[rows], axis=1)
    _check("accelerometers' gravity", t[rows], norm, norm, 0.5, _ACCEL_FACTORS, _GRAVITY_TOLERANCE)


def _check(
    name: str,
    t: Array,
    values: Array,
    size: Array,
    quantile: float,
    factors: dict[float, str],
    tolerance: float,
) -> None:
    """Raise InputError if `values` change by one of the factors, and the largest of `size` do as well.

    quantile: that of the windows of a block, which then is the same in all blocks of one unit.
    """
    count = len(values) // (_WINDOW * _BLOCKS)
    if count < _MIN_WINDOWS:
        return
    shape = (_BLOCKS, count, _WINDOW)
    windows, sizes = (it[: math.prod(shape)].reshape(shape).mean(axis=2) for it in (values, size))
    quiet = np.quantile(windows, quantile, axis=1)
    if quiet.min() <= 0.0:
        return
    levels = np.log(quiet)
    # The block in which the unit changes is on neither side.
    for k in range(_MIN_SIDE, _BLOCKS - _MIN_SIDE):
        before, after = levels[:k], levels[k + 1 :]
        change = float(np.median(after) - np.median(before))
        spread = max(float(np.abs(part - np.median(part)).max()) for part in (before, after))
        later, earlier = np.quantile(sizes[k + 1 :], _LOUD_SHARE), np.quantile(sizes[:k], _LOUD_SHARE)
        for factor, units in factors.items():
            is_factor = abs(abs(change) - math.log(factor)) < tolerance and spread < math.log(factor) / 4.0
            if is_factor and abs(math.log(later / earlier) - change) < _SIZE_TOLERANCE:
                middle = math.exp(float(np.median(before) + np.median(after)) / 2.0)
                rises = np.where((windows.ravel() > middle) == (change > 0.0), 1, -1)
                at = t[_WINDOW * int(np.argmin(np.concatenate(([0], np.cumsum(rises)))))]
                raise InputError(
                    f"the {name} changes by a factor of {math.exp(change):.3g} at about {at:.6g} s, as "
                    f"between {units}: the record is in two units; convert one part, or calibrate each alone"
                )
