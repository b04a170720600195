"""From time-stamped samples to an even grid: interval, gaps, outliers; nothing is invented in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from hubodo.errors import InputError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Spans = Sequence[tuple[float, float]]

# Off an integer number of intervals by more than this, a stamp does not sit on the grid.
_OFF_GRID = 0.3
# A pause this long is a gap even where stamps come in bursts.
_PAUSE_INTERVALS, _PAUSE_S = 5.0, 1.0
_OUTLIER_BLOCK = 200
_LONGEST_OUTLIER = 3
# A grid of which so little is filled comes from a wild stamp, and would not fit into memory.
_MOST_EMPTY, _ALWAYS_FITS = 20, 4_000_000
# In any unit. Variances of variances stay within the range of float64.
_SMALLEST_SPAN, _LARGEST_SPAN = 1e-70, 1e70


@dataclass(frozen=True)
class EvenGrid:
    """A record on an even grid.

    values: (N,) samples, 0 where none is present. present: (N,) bool. dt: interval in s. start: time of the
    first sample in s. gaps: ((start s, missing samples), ...). jitter: rms distance of the stamps from the
    grid in intervals. outliers: times in s of samples that were taken out. notes: lines for people. excluded:
    (from, to) in s of what was left out as disturbed.
    """

    values: FloatArray
    present: BoolArray
    dt: float
    start: float
    gaps: tuple[tuple[float, int], ...]
    jitter: float
    outliers: FloatArray
    notes: tuple[str, ...]
    excluded: Spans = ()

    @property
    def duration(self) -> float:
        """Length in s, gaps included."""
        return len(self.values) * self.dt

    @property
    def missing(self) -> int:
        """Samples missing, outliers included."""
        return int(len(self.values) - np.count_nonzero(self.present))

    def slope(self) -> float:
        """Least-squares slope of the samples that are present, unit/s."""
        t = np.arange(len(self.values)) * self.dt
        mean_t, mean_y = t[self.present].mean(), self.values[self.present].mean()
        t -= mean_t
        t[~self.present] = 0.0
        return float(t @ (self.values - mean_y) / (t @ t))


def as_is(t: FloatArray, values: FloatArray) -> EvenGrid:
    """Every sample, one beside the other at their mean interval, whatever the stamps say of gaps.

    t: (N,) s, strictly increasing. values: (N,). Raises InputError as `even_grid`.
    """
    _check(t, values)
    dt = float((t[-1] - t[0]) / (len(t) - 1))
    return EvenGrid(values, np.ones(len(values), bool), dt, float(t[0]), (), float("nan"), t[:0], ())


def even_grid(
    t: FloatArray, values: FloatArray, *, reject_outliers: bool = True, excluded: Spans = ()
) -> EvenGrid:
    """Place samples on the even grid that their stamps tell.

    t: (N,) s, strictly increasing. values: (N,). The interval is the median of the differences, refined over
    the whole record; a difference of k intervals means k - 1 missing samples. Outliers are up to three
    samples in a row, further from the running median than Gaussian noise reaches once in a hundred records.
    excluded: (from, to) in s, samples in it are taken as missing. Raises InputError: fewer than 16 samples,
    not finite, all equal, time not increasing.
    """
    _check(t, values)
    notes: list[str] = []
    dt, places, even = _places(t)
    _check_filled(t, places)
    if not even:
        notes.append(
            "the time stamps do not sit on an even grid, as when samples are stamped in bursts: they are "
            f"taken as even by {dt:.6g} s between pauses; averaging times below some tens of samples are "
            "only as good as that"
        )
    dt = float((t[-1] - t[0]) / places[-1])
    off = t - t[0] - places * dt
    jitter = float(np.std(off - np.mean(off)) / dt) if even else float("nan")
    missing = np.diff(places) - 1
    gaps = tuple((float(t[k]), int(missing[k])) for k in np.flatnonzero(missing))
    out = np.zeros(len(t), bool)
    for begin, end in excluded:
        out[np.searchsorted(t, begin) : np.searchsorted(t, end, "right")] = True
    bad = _outliers(values) & ~out if reject_outliers else np.zeros(len(values), bool)
    if gaps:
        lost = sum(number for _, number in gaps)
        longest = max(gaps, key=lambda gap: gap[1])
        notes.append(
            f"{len(gaps)} gaps, {lost} samples ({lost / (places[-1] + 1):.2%}) missing; longest "
            f"{longest[1] * dt:.3g} s at {longest[0]:.6g} s; windows with less than 90 % of their samples "
            "not used"
        )
    if bad.any():
        first = float(t[int(np.argmax(bad))])
        notes.append(f"{int(bad.sum())} outliers taken out as missing samples, the first at {first:.6g} s")
    if not gaps and not bad.any() and not out.any():
        return EvenGrid(values, np.ones(len(values), bool), dt, float(t[0]), (), jitter, t[:0], tuple(notes))
    placed = np.zeros(int(places[-1]) + 1)
    present = np.zeros(len(placed), bool)
    kept = ~bad & ~out
    placed[places[kept]] = values[kept]
    present[places[kept]] = True
    return EvenGrid(placed, present, dt, float(t[0]), gaps, jitter, t[bad], tuple(notes), tuple(excluded))


def _check(t: FloatArray, values: FloatArray) -> None:
    """Raises InputError for a record that cannot be put on a grid."""
    if len(t) < 16:
        raise InputError(
            f"{len(t)} samples are too few to characterise a sensor; record at least some minutes"
        )
    if not (np.isfinite(t).all() and np.isfinite(values).all()):
        raise InputError("the record holds values that are not finite; import it with --repair")
    if values.min() == values.max():
        raise InputError(
            f"all {len(values)} samples equal {values[0]:.6g}: the sensor is stuck or not connected, or the "
            "channel is not measured; a sensor at rest shows noise"
        )
    if not _SMALLEST_SPAN <= np.ptp(values) <= _LARGEST_SPAN:
        raise InputError(
            f"the samples span {np.ptp(values):.3g}, which no sensor shows; check the unit of the channel"
        )
    steps = np.diff(t)
    if not bool((steps > 0).all()):
        row = int(np.argmin(steps)) + 1
        raise InputError(f"time does not increase at sample {row} (t = {t[row]:.6g} s); import with --repair")


def _check_filled(t: FloatArray, places: NDArray[np.int64]) -> None:
    if places[-1] <= max(_MOST_EMPTY * len(t), _ALWAYS_FITS):
        return
    row = int(np.argmax(np.diff(places)))
    raise InputError(
        f"nothing between {t[row]:.6g} s and {t[row + 1]:.6g} s, far longer than all that was recorded: a "
        f"wild time stamp, or two records; take one side of it with --end {t[row]:.6g} or --start "
        f"{t[row + 1]:.6g}"
    )


def _places(t: FloatArray) -> tuple[float, NDArray[np.int64], bool]:
    """Interval in s, (N,) place of each sample on the grid, and whether the stamps sit on it."""
    steps = np.diff(t)
    dt = float(np.median(steps))
    counts = np.maximum(1, np.rint(steps / dt)).astype(np.int64)
    off = np.abs(steps / dt - counts) > _OFF_GRID
    # Either the stamps sit anywhere, or most samples would be missing in many short gaps: stamped in bursts.
    even = not (np.mean(off) > 0.1 or (np.mean(counts > 1) > 0.05 and np.sum(counts) > 2 * len(counts)))
    if not even:
        dt, counts = _bursty(t, steps)
    return dt, np.concatenate(([0], np.cumsum(counts))), even


def _bursty(t: FloatArray, steps: FloatArray) -> tuple[float, NDArray[np.int64]]:
    """Interval and grid steps where stamps come in bursts: even between pauses."""
    pauses = steps > max(_PAUSE_S, _PAUSE_INTERVALS * float(np.mean(steps)))
    dt = float(np.sum(steps[~pauses]) / np.count_nonzero(~pauses))
    counts = np.ones(len(steps), np.int64)
    counts[pauses] = np.maximum(1, np.rint(steps[pauses] / dt))
    return dt, counts


def _outliers(values: FloatArray) -> BoolArray:
    """(N,) True for isolated samples far from the running median of their surroundings."""
    count = len(values)
    blocks = max(1, count // _OUTLIER_BLOCK)
    size = count // blocks
    medians = np.median(values[: blocks * size].reshape(blocks, size), axis=1)
    centres = (np.arange(blocks) + 0.5) * size - 0.5
    rest = values - np.interp(np.arange(count), centres, medians)
    # Behind a coarse converter most samples are the same: the span of nine tenths then tells the noise.
    low, high = np.quantile(rest, (0.05, 0.95))
    spread = max(1.4826 * float(np.median(np.abs(rest))), float(high - low) / 3.29, np.finfo(float).tiny)
    # One false alarm in a hundred records, for noise with tails a little heavier than Gaussian or coarse
    # steps.
    reach = 1.25 * -float(ndtri(0.005 / count)) * spread + _step(values)
    far = np.abs(rest) > reach
    if not far.any():
        return far
    edges = np.flatnonzero(np.diff(np.concatenate(([0], far.astype(np.int8), [0]))))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin > _LONGEST_OUTLIER:
            far[begin:end] = False
    return far


def _step(values: FloatArray) -> float:
    """Quantisation step: the smallest difference of a stretch of samples that is not rounding."""
    levels = np.unique(values[:5000])
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * max(abs(float(levels[0])), abs(float(levels[-1])), 1e-300)]
    return float(steps.min()) if len(steps) else 0.0
