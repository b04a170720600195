"""Plateaus of a rate table: spans of constant rate, with the mean of the gyro in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu.standstills import find_quiet_segments, mean_sigma
from hubodo.sensors.imu.uneven_codes import describe_uneven_codes, uneven_mean_sigma

SAME_RATE = 1e-3
"""Difference of two rates, relative to the largest, up to which they are one."""
_MIN_PLATEAU_SAMPLES = 20
_MAX_CHANGE_NOISE, _MAX_CHANGE_SHARE = 10.0, 0.01
"""Scatter of the typical plateau, in white noise and as a share of the steps of rate, above which it is no
plateau of the gyro.
"""
_MIN_REPEATED, _MAX_DEVIATION, _MAX_SLIPPED_SHARE = 3, 10.0, 0.2
"""Plateaus of one rate that show which of them is off, its deviation in units of the usual one, and the share
of plateaus that may be left out.
"""
_MAX_SPREAD = 4.0
"""Scatter of the samples relative to the median plateau, beyond which a plateau was disturbed."""


@dataclass(frozen=True)
class Plateaus:
    """K plateaus in order of time.

    Attributes:
        t, duration: (K,) middle and length, s.
        rate: (K,) of the table, rad/s.
        reading: (K,) mean of the gyro, rad/s.
        sigma: (K,) standard error of the mean.
        uneven: error (1σ) of the reading of one rate by uneven or missing codes, rad/s.
        notes: one line for each plateau that was left out.
    """

    t: Array
    duration: Array
    rate: Array
    reading: Array
    sigma: Array
    notes: tuple[str, ...] = ()
    uneven: float = 0.0


def plateaus_from_table(t: Array, gyro: Array, table_t: Array, table_rate: Array, settle: float) -> Plateaus:
    """Return the plateaus of the rates of the table, which hold until its next row.

    t: (N,) s. gyro: (N,) rad/s. settle: time cut at both ends, s.
    """
    same = SAME_RATE * max(float(np.abs(table_rate).max()), 1e-12)
    first = np.flatnonzero(np.abs(np.diff(table_rate, prepend=np.inf)) > same)
    ends = np.append(table_t[first[1:]], max(float(t[-1]), float(table_t[-1])))
    rates = np.array([float(np.mean(part)) for part in np.split(table_rate, first[1:])])
    # The rate of a dense table changes with each row of a ramp, so a row of a ramp is too short a plateau.
    return _evaluate(t, gyro, np.column_stack([table_t[first], ends]), rates, settle)


def plateaus_from_list(
    t: Array, gyro: Array, rates: Sequence[float], settle: float, min_duration: float
) -> Plateaus:
    """Return the steady segments of the gyro, one for each rate (rad/s) of the list, in order.

    Raises CalibrationError if their numbers differ.
    """
    starts, ends = find_quiet_segments(t, gyro[:, None])
    spans = np.column_stack([t[starts], t[ends - 1]])
    is_long = spans[:, 1] - spans[:, 0] >= min_duration
    if np.count_nonzero(is_long) != len(rates):
        means = [gyro[i:j].mean() for i, j in zip(starts[is_long], ends[is_long], strict=True)]
        raise CalibrationError(
            f"{len(rates)} rates are listed, and the gyro shows {len(means)} steady segments of "
            f"{min_duration:g} s or more ({', '.join(f'{np.degrees(it):.4g}' for it in means)} deg/s); "
            "list each, change --min-plateau, or give times and rates with --table"
        )
    return _evaluate(t, gyro, spans[is_long], np.asarray(rates, float), settle)


def _evaluate(t: Array, gyro: Array, spans: Array, rates: Array, settle: float) -> Plateaus:
    """Return the plateaus with enough samples after `settle` s are cut at both ends of each span."""
    parts = [np.flatnonzero((t >= a + settle) & (t <= b - settle)) for a, b in spans]
    used = [k for k, part in enumerate(parts) if len(part) >= _MIN_PLATEAU_SAMPLES]
    if not used:
        raise CalibrationError(
            "no plateau has enough samples: rates must last longer than twice --settle, at times of the log"
        )
    scatter = np.array([np.diff(gyro[parts[k]]).std() for k in used])
    spread = np.array([gyro[parts[k]].std() for k in used])
    _check_times(spread, scatter, rates[used])
    limit = _MAX_SPREAD * float(np.median(np.maximum(spread, scatter / np.sqrt(2.0))))
    calm = [k for k, s in zip(used, spread, strict=True) if s <= limit or limit == 0.0]
    notes = tuple(
        f"plateau of {np.degrees(rates[k]):.4g} deg/s at {t[parts[k][0]]:.1f} s left out: it was disturbed"
        for k in used
        if k not in calm
    )
    step = float(np.median(np.diff(t)))
    pairs = [(int(parts[k][0]), int(parts[k][-1]) + 1) for k in calm]
    root_count = np.sqrt([j - i for i, j in pairs])
    # One noise for all: a plateau that happens to be calm is not more precise than others.
    scatter_of_one = mean_sigma(gyro[:, None], pairs, max(4, round(0.5 / step)))[:, 0] * root_count
    uneven, unevenness, code = uneven_mean_sigma(gyro[:, None], pairs)
    if unevenness:
        codes = describe_uneven_codes("gyro's", unevenness, f"{np.degrees(code):.3g} deg/s")
        notes += (f"{codes}: the sigmas include it, once for each rate",)
    return _drop_slipped(
        Plateaus(
            np.array([t[i:j].mean() for i, j in pairs]),
            np.array([t[j - 1] - t[i] for i, j in pairs]),
            rates[calm],
            np.array([gyro[i:j].mean() for i, j in pairs]),
            float(np.sqrt(np.mean(scatter_of_one**2))) / root_count,
            notes,
            float(uneven[0]),
        )
    )


def _drop_slipped(plateaus: Plateaus) -> Plateaus:
    """Return the plateaus without the few whose reading contradicts the others of the same rate."""
    _, cell = distinct_rates(plateaus.rate)
    off = np.zeros(len(cell))
    for j in np.flatnonzero(np.bincount(cell) >= _MIN_REPEATED):
        off[cell == j] = plateaus.reading[cell == j] - np.median(plateaus.reading[cell == j])
    judged = np.bincount(cell)[cell] >= _MIN_REPEATED
    if not judged.any():
        return plateaus
    usual = np.maximum(1.4826 * float(np.median(np.abs(off[judged]))), plateaus.sigma)
    slipped = np.abs(off) > _MAX_DEVIATION * usual
    if not 0 < np.count_nonzero(slipped) <= _MAX_SLIPPED_SHARE * len(cell):
        return plateaus
    notes = tuple(
        f"plateau of {np.degrees(plateaus.rate[k]):.4g} deg/s at {plateaus.t[k]:.1f} s left out: it differs "
        f"by {np.degrees(off[k]):.3g} deg/s from the others of this rate, as if the table had slipped"
        for k in np.flatnonzero(slipped)
    )
    part = {name: getattr(plateaus, name)[~slipped] for name in ("t", "duration", "rate", "reading", "sigma")}
    return Plateaus(**part, notes=(*plateaus.notes, *notes), uneven=plateaus.uneven)


def distinct_rates(rate: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the (J,) distinct rates, ascending, and the index of each plateau's."""
    order = np.argsort(rate)
    jumps = np.diff(rate[order]) > SAME_RATE * float(np.abs(rate).max())
    group: NDArray[np.int64] = np.empty(len(rate), np.int64)
    group[order] = np.concatenate([[0], np.cumsum(jumps)])
    return np.array([rate[group == j].mean() for j in range(group.max() + 1)]), group


def _check_times(spread: Array, scatter: Array, rates: Array) -> None:
    """Raise InputError if the gyro changes within the typical plateau: the times are not those of the table.

    spread, scatter: (K,) standard deviations of the samples, and of their differences. rates: (K,) rad/s.
    """
    white = float(np.median(scatter)) / np.sqrt(2.0)
    step = float(np.median(np.abs(np.diff(rates)))) if len(rates) > 1 else 0.0
    typical = float(np.quantile(spread, 0.75))
    if typical > max(_MAX_CHANGE_NOISE * white, _MAX_CHANGE_SHARE * step):
        raise InputError(
            f"the gyro changes by {np.degrees(typical):.3g} deg/s (1σ) while the table's rate is constant: "
            "the clocks of table and log differ; correct the times, raise --settle, or give --rates-deg-s"
        )
