"""Standstills in a recording, found by the recording's own noise floor, with the mean of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import CalibrationError

WINDOW_S = 0.5
"""Length of the sliding window in which a sample must be quiet."""
THRESHOLD = 3.0
"""Times the noise floor.

The 5 % quantile of the window deviation lies at 0.84 sigma for 50 samples, so 3 times it is 2.5 sigma: the
chance that white noise alone exceeds it is nil, and a turn exceeds it by orders.
"""
FLOOR_QUANTILE = 0.05
MARGIN_S = 0.1
"""Cut off each end of a rest: a hand that lets go is felt before it is seen."""
CREEP_SIGMA = 6.0
TURNING = 0.02
"""rad/s off the middle of all rests; no bias moves so far with pose, a node that quietly turns does."""
CREEP_ACCEL = 0.02
"""m/s²; halves of a rest that differ by more, and by CREEP_SIGMA, were none: 0.12 degrees of tilt."""


@dataclass(frozen=True)
class Rests:
    """R standstills in order of time.

    start, end: (R,) first sample and one past the last. t: (R, 2) s. gyro, accel: (R, 3) means.
    gyro_sigma, accel_sigma: (R, 3) standard errors of the means, at least those of the blocks of 0.5 s.
    rejected: one line for each standstill that was left out, with its time.
    """

    start: NDArray[np.int64]
    end: NDArray[np.int64]
    t: Array
    gyro: Array
    accel: Array
    gyro_sigma: Array
    accel_sigma: Array
    rejected: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.start)

    @property
    def duration(self) -> Array:
        """(R,) s."""
        return np.asarray(self.t[:, 1] - self.t[:, 0])

    def select(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> Rests:
        """Those rests alone, by index or mask."""
        return Rests(
            self.start[which],
            self.end[which],
            self.t[which],
            self.gyro[which],
            self.accel[which],
            self.gyro_sigma[which],
            self.accel_sigma[which],
            self.rejected,
        )


def find_rests(t: Array, gyro: Array, accel: Array, *, min_duration: float = 1.0) -> Rests:
    """Stretches of at least `min_duration` s in which all six channels stay near their noise floor.

    t: (N,) s, increasing. gyro: (N, 3) rad/s. accel: (N, 3) m/s². A gap in time ends a rest. A rest in which
    gravity still creeps is left out and named. Raises CalibrationError when the record is too short, constant
    in all channels of a triad, or nowhere at rest.
    """
    step, width = _window(t, gyro, accel, min_duration)
    starts, ends = _runs(_quiet(gyro, width) & _quiet(accel, width), width, np.diff(t) > 5 * step)
    margin = round(MARGIN_S / step)
    starts, ends = starts + margin, ends - margin
    keep = (ends - starts) * step >= min_duration
    starts, ends = starts[keep], ends[keep]
    good, rejected = _truly_at_rest(t, gyro, accel, starts, ends)
    if not good:
        why = f" ({rejected[0]})" if rejected else ""
        raise CalibrationError(
            f"no standstill of {min_duration} s was found{why}; put the node down and leave it for a few "
            "seconds in each pose"
        )
    starts, ends = starts[good], ends[good]
    pairs = list(zip(starts, ends, strict=True))
    return Rests(
        starts,
        ends,
        np.column_stack([t[starts], t[ends - 1]]),
        np.array([gyro[i:j].mean(axis=0) for i, j in pairs]),
        np.array([accel[i:j].mean(axis=0) for i, j in pairs]),
        np.array([standard_error(gyro[i:j], width) for i, j in pairs]),
        np.array([standard_error(accel[i:j], width) for i, j in pairs]),
        tuple(rejected),
    )


def _window(t: Array, gyro: Array, accel: Array, min_duration: float) -> tuple[float, int]:
    """s between samples, and samples of the sliding window. Raises CalibrationError for a useless record."""
    if len(t) < 2 or t[-1] - t[0] < min_duration:
        raise CalibrationError(
            f"the record is {t[-1] - t[0] if len(t) else 0:.1f} s long, shorter than one rest of "
            f"{min_duration} s; record longer"
        )
    for name, values in (("gyro", gyro), ("accel", accel)):
        if not np.ptp(values, axis=0).any():
            raise CalibrationError(f"the {name} never changes: the sensor is stuck or off; check the node")
    step = float(np.median(np.diff(t)))
    width = max(4, round(WINDOW_S / step))
    if len(t) < 2 * width:
        raise CalibrationError(
            f"the record has only {len(t)} samples at {1 / step:.1f} Hz; record longer or faster"
        )
    return step, width


def _truly_at_rest(
    t: Array, gyro: Array, accel: Array, starts: NDArray[np.int64], ends: NDArray[np.int64]
) -> tuple[list[int], list[str]]:
    """Which quiet stretches are rests, and a line for each in which gravity creeps or the node turns."""
    rejected, good = [], []
    for k, (i, j) in enumerate(zip(starts, ends, strict=True)):
        creep = _creep(accel[i:j])
        if creep:
            rejected.append(f"standstill at {t[i]:.1f}..{t[j - 1]:.1f} s left out: {creep}")
        else:
            good.append(k)
    if not good:
        return good, rejected
    means = np.array([gyro[starts[k] : ends[k]].mean(axis=0) for k in good])
    rate = np.linalg.norm(means - np.median(means, axis=0), axis=1)
    rejected += [
        f"standstill at {t[starts[k]]:.1f}..{t[ends[k] - 1]:.1f} s left out: the node turned at {r:.3f} "
        "rad/s in it"
        for k, r in zip(good, rate, strict=True)
        if r > TURNING
    ]
    return [k for k, r in zip(good, rate, strict=True) if r <= TURNING], rejected


def find_steady_rates(
    t: Array, gyro: Array, rate: float, bias: Array, *, min_duration: float = 1.0
) -> tuple[Array, Array]:
    """Means (R, 3) rad/s and their standard errors of stretches at a steady turn of about `rate` rad/s.

    bias: (3,) rad/s from the rests. A stretch counts when its rate is within a third of the table's. Raises
    CalibrationError when there is none.
    """
    step = float(np.median(np.diff(t)))
    width = max(4, round(WINDOW_S / step))
    starts, ends = _runs(_quiet(gyro, width), width, np.diff(t) > 5 * step)
    margin = round(MARGIN_S / step)
    spans = [(i + margin, j - margin) for i, j in zip(starts, ends, strict=True)]
    spans = [(i, j) for i, j in spans if (j - i) * step >= min_duration]
    spans = [
        (i, j) for i, j in spans if abs(np.linalg.norm(gyro[i:j].mean(axis=0) - bias) / rate - 1) < 1 / 3
    ]
    if not spans:
        raise CalibrationError(
            f"no steady turn of about {rate:.4g} rad/s and at least {min_duration} s was found; check the "
            f"table's rate "
            "(rad/s) and turn the node steadily in nine or more poses"
        )
    means = np.array([gyro[i:j].mean(axis=0) for i, j in spans])
    return means, np.array([standard_error(gyro[i:j], width) for i, j in spans])


def standard_error(values: Array, width: int) -> Array:
    """(C,) 1 sigma of the mean of (N, C) values, of white noise or of blocks of `width` samples.

    The larger of both.
    """
    n = len(values)
    white = values.std(axis=0, ddof=1) / np.sqrt(n)
    blocks = n // width
    if blocks < 4:
        return np.asarray(white)
    means = values[: blocks * width].reshape(blocks, width, -1).mean(axis=1)
    return np.asarray(np.maximum(white, means.std(axis=0, ddof=1) / np.sqrt(blocks)))


def _quiet(values: Array, width: int) -> NDArray[np.bool_]:
    """(N - width + 1,) whether the window of `width` samples that begins here is quiet in all channels."""
    centred = values - values.mean(axis=0)
    sums = np.vstack([np.zeros(3), np.cumsum(centred, axis=0)])
    squares = np.vstack([np.zeros(3), np.cumsum(centred**2, axis=0)])
    mean = (sums[width:] - sums[:-width]) / width
    deviation = np.sqrt(np.maximum((squares[width:] - squares[:-width]) / width - mean**2, 0.0))
    floor = np.maximum(np.quantile(deviation, FLOOR_QUANTILE, axis=0), _resolution(values) / np.sqrt(12))
    return np.asarray((deviation < THRESHOLD * floor).all(axis=1))


def _resolution(values: Array) -> Array:
    """(3,) smallest step that each channel takes."""
    steps = np.abs(np.diff(values, axis=0))
    return np.asarray(np.where(steps > 0, steps, np.inf).min(axis=0, initial=np.inf, where=True)).clip(
        max=np.ptp(values, axis=0)
    )


def _runs(
    quiet: NDArray[np.bool_], width: int, gap: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and one-past-last sample of each stretch that quiet windows cover without a seam.

    Two samples belong together when one quiet window holds both, so that a sudden change of pose is a seam
    even though quiet windows end and begin right at it. gap: (N - 1,) True where time jumps; a seam too.
    """
    count = len(gap) + 1
    change = np.zeros(count, np.int64)
    change[: len(quiet)] += quiet
    change[width - 1 :] -= quiet
    joined = (np.cumsum(change)[: count - 1] > 0) & ~gap
    edges = np.diff(np.concatenate([[0], joined.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) + 1


def _creep(accel: Array) -> str:
    """Why this stretch is no rest, or ""."""
    half = len(accel) // 2
    first, second = accel[:half], accel[half:]
    moved = np.abs(second.mean(axis=0) - first.mean(axis=0))
    # White noise from successive differences: the creep itself must not widen its own limit.
    error = np.diff(accel, axis=0).std(axis=0) / np.sqrt(half)
    if bool((moved > np.maximum(CREEP_SIGMA * error, CREEP_ACCEL)).any()):
        return f"gravity crept by {moved.max():.3f} m/s² within it, so the node still moved"
    return ""
