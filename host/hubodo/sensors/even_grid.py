"""Placement of time-stamped samples on an even grid, with gaps and outliers marked, without interpolation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from hubodo.arrays import Array, find_runs
from hubodo.errors import InputError

BoolArray = NDArray[np.bool_]
Spans = Sequence[tuple[float, float]]

# Distance, in intervals, from a grid point above which a stamp is not on the grid.
_MAX_OFF_GRID_INTERVALS = 0.3
# Where stamps come in bursts, a pause is a gap only if it exceeds this many mean intervals and this many
# seconds.
_PAUSE_INTERVALS, _PAUSE_S = 5.0, 1.0
_OUTLIER_BLOCK_SAMPLES = 200
_MAX_OUTLIER_RUN = 3
# A grid larger than this many indices per sample comes from a corrupt time stamp and might not fit into
# memory; grids up to the second number always do.
_MAX_INDICES_PER_SAMPLE, _ALWAYS_ALLOWED_INDICES = 20, 4_000_000
# Span of the samples in any unit, such that variances of variances stay within the range of float64.
_MIN_SPAN, _MAX_SPAN = 1e-70, 1e70


@dataclass(frozen=True)
class EvenGrid:
    """A record on an even grid.

    Attributes:
        values: (N,) samples, 0 where a sample is missing.
        present: (N,) bool.
        dt: sample interval, s.
        start: time of the first sample, s.
        gaps: start time (s) and number of missing samples of each gap.
        jitter: rms deviation of the time stamps from the grid, in intervals; NaN for uneven stamps.
        outliers: times of the samples removed as outliers, s.
        notes: remarks for the user.
        excluded: (start, end) of the spans excluded as disturbed, s.
    """

    values: Array
    present: BoolArray
    dt: float
    start: float
    gaps: tuple[tuple[float, int], ...]
    jitter: float
    outliers: Array
    notes: tuple[str, ...]
    excluded: Spans = ()

    @property
    def duration(self) -> float:
        """Return the length in s, including gaps."""
        return len(self.values) * self.dt

    @property
    def missing(self) -> int:
        """Return the number of missing samples, including outliers."""
        return int(len(self.values) - np.count_nonzero(self.present))

    def slope(self) -> float:
        """Return the least-squares slope of the samples present, unit/s."""
        t = np.arange(len(self.values)) * self.dt
        mean_t, mean_y = t[self.present].mean(), self.values[self.present].mean()
        t -= mean_t
        t[~self.present] = 0.0
        return float(t @ (self.values - mean_y) / (t @ t))


def grid_all_samples(t: Array, values: Array) -> EvenGrid:
    """Place all samples at their mean interval, ignoring gaps in the time stamps.

    t: (N,) s, strictly increasing. values: (N,). Raises InputError like `place_on_grid`.
    """
    _check_record(t, values)
    dt = float((t[-1] - t[0]) / (len(t) - 1))
    return EvenGrid(values, np.ones(len(values), bool), dt, float(t[0]), (), float("nan"), t[:0], ())


def place_on_grid(t: Array, values: Array, *, reject_outliers: bool = True, excluded: Spans = ()) -> EvenGrid:
    """Place samples on an even grid derived from their time stamps.

    t: (N,) s, strictly increasing. values: (N,). The interval is the median of the time differences,
    refined over the whole record; a difference of k intervals means k - 1 missing samples. Outliers are up
    to three consecutive samples further from the running median than Gaussian noise would be once in a
    hundred records. excluded: (start, end) in s; samples within are treated as missing. Raises InputError
    if there are fewer than 16 samples, if values are not finite or all equal, or if time does not
    increase.
    """
    _check_record(t, values)
    notes: list[str] = []
    dt, indices, is_even = _grid_indices(t)
    _check_grid_size(t, indices)
    if not is_even:
        notes.append(
            "the time stamps are not on an even grid, as when samples are stamped in bursts: an interval of "
            f"{dt:.6g} s between pauses is assumed; averaging times below some tens of samples depend on it"
        )
    dt = float((t[-1] - t[0]) / indices[-1])
    stamp_error = t - t[0] - indices * dt
    jitter = float(np.std(stamp_error - np.mean(stamp_error)) / dt) if is_even else float("nan")
    missing = np.diff(indices) - 1
    gaps = tuple((float(t[k]), int(missing[k])) for k in np.flatnonzero(missing))
    is_excluded = np.zeros(len(t), bool)
    for start, end in excluded:
        is_excluded[np.searchsorted(t, start) : np.searchsorted(t, end, "right")] = True
    is_outlier = _find_outliers(values) & ~is_excluded if reject_outliers else np.zeros(len(values), bool)
    if gaps:
        missing_count = sum(number for _, number in gaps)
        longest = max(gaps, key=lambda gap: gap[1])
        notes.append(
            f"{len(gaps)} gaps, {missing_count} samples ({missing_count / (indices[-1] + 1):.2%}) missing; "
            f"longest {longest[1] * dt:.3g} s at {longest[0]:.6g} s; windows with less than 90 % of their "
            "samples are not used"
        )
    if is_outlier.any():
        first = float(t[int(np.argmax(is_outlier))])
        notes.append(
            f"{int(is_outlier.sum())} outliers taken out as missing samples, the first at {first:.6g} s"
        )
    if not gaps and not is_outlier.any() and not is_excluded.any():
        return EvenGrid(values, np.ones(len(values), bool), dt, float(t[0]), (), jitter, t[:0], tuple(notes))
    grid_values = np.zeros(int(indices[-1]) + 1)
    present = np.zeros(len(grid_values), bool)
    usable = ~is_outlier & ~is_excluded
    grid_values[indices[usable]] = values[usable]
    present[indices[usable]] = True
    return EvenGrid(
        grid_values, present, dt, float(t[0]), gaps, jitter, t[is_outlier], tuple(notes), tuple(excluded)
    )


def _check_record(t: Array, values: Array) -> None:
    """Raise InputError if a record cannot be placed on a grid."""
    if len(t) < 16:
        raise InputError(
            f"{len(t)} samples are too few to characterise a sensor; record at least some minutes"
        )
    if not (np.isfinite(t).all() and np.isfinite(values).all()):
        raise InputError("the record holds values that are not finite; import it with --repair")
    if values.min() == values.max():
        raise InputError(
            f"all {len(values)} samples equal {values[0]:.6g}: the sensor is stuck or not connected, or the "
            "channel is not measured; a stationary sensor shows noise"
        )
    if not _MIN_SPAN <= np.ptp(values) <= _MAX_SPAN:
        raise InputError(
            f"the samples span {np.ptp(values):.3g}, impossible for a sensor; check the unit of the channel"
        )
    steps = np.diff(t)
    if not bool((steps > 0).all()):
        row = int(np.argmin(steps)) + 1
        raise InputError(f"time does not increase at sample {row} (t = {t[row]:.6g} s); import with --repair")


def _check_grid_size(t: Array, indices: NDArray[np.int64]) -> None:
    if indices[-1] <= max(_MAX_INDICES_PER_SAMPLE * len(t), _ALWAYS_ALLOWED_INDICES):
        return
    row = int(np.argmax(np.diff(indices)))
    raise InputError(
        f"no samples between {t[row]:.6g} s and {t[row + 1]:.6g} s, far longer than all that was recorded: a "
        f"corrupt time stamp, or two records; select one side with --end {t[row]:.6g} or --start "
        f"{t[row + 1]:.6g}"
    )


def _grid_indices(t: Array) -> tuple[float, NDArray[np.int64], bool]:
    """Return the interval in s, the (N,) grid index of each sample, and True if the stamps fit the grid."""
    steps = np.diff(t)
    dt = float(np.median(steps))
    counts = np.maximum(1, np.rint(steps / dt)).astype(np.int64)
    off_grid = np.abs(steps / dt - counts) > _MAX_OFF_GRID_INTERVALS
    # Bursts: more than a tenth of the stamps off the grid, or most samples would be missing in many short
    # gaps.
    is_even = not (
        np.mean(off_grid) > 0.1 or (np.mean(counts > 1) > 0.05 and np.sum(counts) > 2 * len(counts))
    )
    if not is_even:
        dt, counts = _burst_indices(t, steps)
    return dt, np.concatenate(([0], np.cumsum(counts))), is_even


def _burst_indices(t: Array, steps: Array) -> tuple[float, NDArray[np.int64]]:
    """Return interval and grid steps for stamps in bursts, assuming an even rate between pauses."""
    pauses = steps > max(_PAUSE_S, _PAUSE_INTERVALS * float(np.mean(steps)))
    dt = float(np.sum(steps[~pauses]) / np.count_nonzero(~pauses))
    counts = np.ones(len(steps), np.int64)
    counts[pauses] = np.maximum(1, np.rint(steps[pauses] / dt))
    return dt, counts


def _find_outliers(values: Array) -> BoolArray:
    """Return (N,) True for isolated samples far from their running median."""
    count = len(values)
    blocks = max(1, count // _OUTLIER_BLOCK_SAMPLES)
    size = count // blocks
    medians = np.median(values[: blocks * size].reshape(blocks, size), axis=1)
    centres = (np.arange(blocks) + 0.5) * size - 0.5
    residual = values - np.interp(np.arange(count), centres, medians)
    # With coarse quantisation most samples are equal; the noise then follows from the span of 90 % of them.
    low, high = np.quantile(residual, (0.05, 0.95))
    spread = max(1.4826 * float(np.median(np.abs(residual))), float(high - low) / 3.29, np.finfo(float).tiny)
    # One false alarm in a hundred records, for noise with slightly heavier tails than Gaussian or coarse
    # quantisation.
    threshold = 1.25 * -float(ndtri(0.005 / count)) * spread + _quantisation_step(values)
    is_outlier = np.abs(residual) > threshold
    for start, end in find_runs(is_outlier):
        if end - start > _MAX_OUTLIER_RUN:
            is_outlier[start:end] = False
    return is_outlier


def _quantisation_step(values: Array) -> float:
    """Return the quantisation step: the smallest difference of the first 5000 samples above rounding."""
    levels = np.unique(values[:5000])
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * max(abs(float(levels[0])), abs(float(levels[-1])), 1e-300)]
    return float(steps.min()) if len(steps) else 0.0
