"""Detection of standstills in a recording by its noise floor, and the means of each standstill."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.quantisation import find_quantisation_steps, undithered_sigma
from hubodo.sensors.imu.range_limits import describe_limit, limit_windows

QUIET_WINDOW_S = 0.5
"""Length of the sliding window in which all channels must be quiet."""
QUIET_THRESHOLD_SIGMA = 2.5
"""Largest standard deviation of a quiet window, relative to the noise; a turn exceeds it by far.

Short windows of white noise may exceed it, so the threshold is at least the value that one window in ten
million exceeds: 2.8 sigma for 5 samples.
"""
_QUIET_FALSE_ALARM = 1e-7
NOISE_FLOOR_QUANTILE = 0.05
"""Quantile of the window deviations that shows the noise: at least this part of a record has to be static."""
STANDSTILL_MARGIN_S = (0.1, 0.4)
"""Shortest and longest time cut at each end of a standstill.

The hand that takes or releases the node moves it below the threshold: the first 0.3 s of a smooth turn by
15 degrees in 2.5 s change the mean rate of a standstill of 6 s by 3e-4 rad/s, nine sigma of 24 of them.
"""
STANDSTILL_MARGIN_SHARE = 1 / 6
"""Time cut at each end of a standstill as a share of its duration, within `STANDSTILL_MARGIN_S`."""
TRIM_SIGMA = 5.0
"""Deviation of a window's mean from the median of its standstill that counts as slow motion, in sigma."""
_MIN_TRIM_BLOCKS = 5
CREEP_SIGMA = 6.0
MAX_STANDSTILL_RATE = 0.02
"""Largest deviation of the mean rate from the median of all standstills, rad/s: more is slow rotation, not
bias.
"""
CREEP_ACCELERATION = 0.02
"""Largest difference between the halves of a standstill, m/s² (0.12 degrees of tilt), if above CREEP_SIGMA
too.
"""


@dataclass(frozen=True)
class Standstills:
    """R standstills in order of time.

    Attributes:
        start, end: (R,) index of the first sample and one past the last.
        t: (R, 2) first and last time, s.
        gyro, accel: (R, 3) means, rad/s and m/s².
        gyro_sigma, accel_sigma: (R, 3) standard errors of the means, at least those from 0.5 s blocks.
        rejected: one line, with its time, for each standstill that was rejected.
        are_means: True if the means were measured as such, without times; `start` then is the row.
    """

    start: NDArray[np.int64]
    end: NDArray[np.int64]
    t: Array
    gyro: Array
    accel: Array
    gyro_sigma: Array
    accel_sigma: Array
    rejected: tuple[str, ...] = ()
    are_means: bool = False

    def __len__(self) -> int:
        return len(self.start)

    @property
    def duration(self) -> Array:
        """Return the (R,) durations, s."""
        return np.asarray(self.t[:, 1] - self.t[:, 0])

    def select(self, which: NDArray[np.int64] | NDArray[np.bool_]) -> Standstills:
        """Return the selected standstills, by index or mask."""
        return replace(
            self,
            start=self.start[which],
            end=self.end[which],
            t=self.t[which],
            gyro=self.gyro[which],
            accel=self.accel[which],
            gyro_sigma=self.gyro_sigma[which],
            accel_sigma=self.accel_sigma[which],
        )

    def name(self, k: int) -> str:
        """Return what identifies standstill `k` in the record, such as `standstill at 3.0..7.5 s`."""
        if self.are_means:
            return f"pose {self.start[k] + 1}"
        return f"standstill at {self.t[k, 0]:.1f}..{self.t[k, 1]:.1f} s"


def find_standstills(
    t: Array,
    gyro: Array,
    accel: Array,
    *,
    min_duration: float = 1.0,
    max_rate: float = MAX_STANDSTILL_RATE,
) -> Standstills:
    """Find standstills of at least `min_duration` s, with all six channels near their noise floor.

    max_rate: largest deviation of the mean rate from the median of all standstills, rad/s.

    t: (N,) s, increasing. gyro: (N, 3) rad/s. accel: (N, 3) m/s². A triad that is not measured has the shape
    (N, 0), and so have its means. A gap in time ends a standstill. A
    standstill in which gravity creeps is rejected with a line in `rejected`. Raises CalibrationError if
    the record is too short, constant in all channels of a triad, or never stationary.
    """
    step, width = _sample_window(t, gyro, accel, min_duration)
    gyro_steps, accel_steps = find_quantisation_steps(gyro), find_quantisation_steps(accel)
    starts, ends = _find_segments(
        _find_quiet_windows(gyro, width, gyro_steps) & _find_quiet_windows(accel, width, accel_steps),
        width,
        np.diff(t) > 5 * step,
    )
    margin = _margins(ends - starts, step)
    starts, ends = starts + margin, ends - margin
    floor = np.concatenate([gyro_steps, accel_steps]) / np.sqrt(12)
    samples = np.hstack([gyro, accel])
    spans = [_trim_slow_motion(samples, i, j, width, floor) for i, j in zip(starts, ends, strict=True)]
    starts, ends = np.array(spans, np.int64).reshape(-1, 2).T
    long_enough = (ends - starts) * step >= min_duration
    starts, ends = starts[long_enough], ends[long_enough]
    accepted, rejected = _select_standstills(t, gyro, accel, starts, ends, max_rate, accel_steps)
    if not accepted:
        details = f" ({rejected[0]})" if rejected else ""
        raise CalibrationError(
            f"no standstill of {min_duration} s was found{details}; put the node down and leave it for a few "
            "seconds in each pose"
        )
    starts, ends = starts[accepted], ends[accepted]
    pairs = list(zip(starts, ends, strict=True))
    return Standstills(
        starts,
        ends,
        np.column_stack([t[starts], t[ends - 1]]),
        np.array([gyro[i:j].mean(axis=0) for i, j in pairs]),
        np.array([accel[i:j].mean(axis=0) for i, j in pairs]),
        mean_sigma(gyro, pairs, width),
        mean_sigma(accel, pairs, width),
        tuple(rejected),
    )


def mean_sigma(values: Array, pairs: list[tuple[int, int]], width: int) -> Array:
    """Return the (R, C) standard errors of the means of spans, including the undithered quantisation."""
    steps = find_quantisation_steps(values)
    scatter = np.sqrt(np.mean([values[i:j].var(axis=0) for i, j in pairs], axis=0))
    random = np.array([standard_error(values[i:j], width) for i, j in pairs])
    return np.asarray(np.hypot(random, undithered_sigma(scatter, steps)))


def _margins(counts: NDArray[np.int64], step: float) -> NDArray[np.int64]:
    """Return the samples to cut at each end of segments with `counts` samples of `step` s."""
    seconds = np.clip(counts * step * STANDSTILL_MARGIN_SHARE, *STANDSTILL_MARGIN_S)
    return np.asarray(np.maximum(1, np.rint(seconds / step)), np.int64)


def _sample_window(t: Array, gyro: Array, accel: Array, min_duration: float) -> tuple[float, int]:
    """Return the sample interval, s, and the window length in samples.

    Raises CalibrationError if the record is too short, or constant in all channels of a triad.
    """
    if len(t) < 2 or t[-1] - t[0] < min_duration:
        raise CalibrationError(
            f"the record is {t[-1] - t[0] if len(t) else 0:.1f} s long, shorter than one standstill of "
            f"{min_duration} s; record longer"
        )
    for name, values in (("gyro", gyro), ("accel", accel)):
        if values.shape[1] and not np.ptp(values, axis=0).any():
            raise CalibrationError(f"the {name} never changes: the sensor is stuck or off; check the node")
    step = float(np.median(np.diff(t)))
    width = max(4, round(QUIET_WINDOW_S / step))
    if len(t) < 2 * width:
        raise CalibrationError(
            f"the record has only {len(t)} samples at {1 / step:.1f} Hz; record longer or faster"
        )
    return step, width


def _trim_slow_motion(samples: Array, start: int, end: int, width: int, floor: Array) -> tuple[int, int]:
    """Return the span without the parts in which a slow turn begins or ends.

    A turn that begins gently is at first taken as quiet in windows of `width` samples, but the means of these
    windows deviate from their median. samples: (N, 6). floor: (6,) smallest noise of a channel.
    """
    blocks = (end - start) // width
    if blocks < _MIN_TRIM_BLOCKS:
        return int(start), int(end)
    part = samples[start : start + blocks * width]
    means = part.reshape(blocks, width, -1).mean(axis=1)
    deviation = np.abs(means - np.median(means, axis=0))
    # White noise is estimated from successive differences, so that a drift does not raise its own threshold.
    white = np.diff(part, axis=0).std(axis=0) / np.sqrt(2.0 * width)
    scale = np.maximum(np.maximum(white, 1.4826 * np.median(deviation, axis=0)), floor)
    at_rest = np.concatenate([[0], (deviation <= TRIM_SIGMA * scale).all(axis=1).astype(np.int8), [0]])
    edges = np.diff(at_rest)
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not len(first):
        return int(start), int(end)
    longest = int(np.argmax(last - first))
    # The neighbour of a moving block moves as well, but below the threshold.
    left = 0 if first[longest] == 0 else (first[longest] + 1) * width
    right = end - start if last[longest] == blocks else (last[longest] - 1) * width
    return int(start + left), int(start + max(right, left))


def _select_standstills(
    t: Array,
    gyro: Array,
    accel: Array,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    max_rate: float,
    accel_steps: Array,
) -> tuple[list[int], list[str]]:
    """Return the indices of true standstills, and a line for each clipped, creeping or turning one."""
    rejected, accepted = [], []
    for k, (i, j) in enumerate(zip(starts, ends, strict=True)):
        fault = describe_limit(accel, accel[i:j], accel_steps, "accelerometer") or _creep_reason(accel[i:j])
        if fault:
            rejected.append(f"standstill at {t[i]:.1f}..{t[j - 1]:.1f} s rejected: {fault}")
        else:
            accepted.append(k)
    if not accepted:
        return accepted, rejected
    means = np.array([gyro[starts[k] : ends[k]].mean(axis=0) for k in accepted])
    rate = np.linalg.norm(means - np.median(means, axis=0), axis=1)
    rejected += [
        f"standstill at {t[starts[k]]:.1f}..{t[ends[k] - 1]:.1f} s rejected: the node turned at {r:.3f} rad/s"
        for k, r in zip(accepted, rate, strict=True)
        if r > max_rate
    ]
    return [k for k, r in zip(accepted, rate, strict=True) if r <= max_rate], rejected


def find_steady_turns(
    t: Array, gyro: Array, rate: float, bias: Array, *, min_duration: float = 1.0
) -> tuple[Array, Array]:
    """Return means (R, 3), rad/s, and standard errors of segments with a steady rate near `rate`.

    bias: (3,) rad/s from the standstills. The rate of a segment must be within a third of the table's. Raises
    CalibrationError if there is none.
    """
    step = float(np.median(np.diff(t)))
    starts, ends = find_quiet_segments(t, gyro)
    margin = max(1, round(STANDSTILL_MARGIN_S[0] / step))
    spans = [(i + margin, j - margin) for i, j in zip(starts, ends, strict=True)]
    spans = [(i, j) for i, j in spans if (j - i) * step >= min_duration]
    spans = [
        (i, j) for i, j in spans if abs(np.linalg.norm(gyro[i:j].mean(axis=0) - bias) / rate - 1) < 1 / 3
    ]
    if not spans:
        raise CalibrationError(
            f"no steady turn of about {rate:.4g} rad/s and at least {min_duration} s was found; check the "
            "table's rate (rad/s) and turn the node steadily in nine or more poses"
        )
    means = np.array([gyro[i:j].mean(axis=0) for i, j in spans])
    return means, mean_sigma(gyro, spans, max(4, round(QUIET_WINDOW_S / step)))


def find_quiet_segments(t: Array, values: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and one-past-last sample of each segment of (N, C) values near their noise floor."""
    step = float(np.median(np.diff(t)))
    width = max(4, round(QUIET_WINDOW_S / step))
    quiet = _find_quiet_windows(values, width, find_quantisation_steps(values))
    return _find_segments(quiet, width, np.diff(t) > 5 * step)


def standard_error(values: Array, width: int) -> Array:
    """Return the (C,) standard error of the mean of (N, C) values.

    It is the larger of that for white noise and that from the means of blocks of `width` samples.
    """
    n = len(values)
    white = values.std(axis=0, ddof=1) / np.sqrt(n)
    blocks = n // width
    if blocks < 4:
        return np.asarray(white)
    means = values[: blocks * width].reshape(blocks, width, -1).mean(axis=1)
    return np.asarray(np.maximum(white, means.std(axis=0, ddof=1) / np.sqrt(blocks)))


def _find_quiet_windows(values: Array, width: int, steps: Array) -> NDArray[np.bool_]:
    """Return (N - width + 1,) True where the window of `width` samples starting here is quiet.

    steps: (3,) quantisation steps.
    """
    deviation = _window_deviations(values, width)
    dof = width - 1
    low = np.sqrt(chdtri(dof, 1.0 - NOISE_FLOOR_QUANTILE) / width)
    high = max(QUIET_THRESHOLD_SIGMA, float(np.sqrt(chdtri(dof, _QUIET_FALSE_ALARM) / width)))
    at_limit = limit_windows(values, width, deviation)
    # A channel that is at its limit all the time has no quiet window, whatever its noise floor.
    noise = np.array(
        [
            np.quantile(channel if limited.all() else channel[~limited], NOISE_FLOOR_QUANTILE)
            for channel, limited in zip(deviation.T, at_limit.T, strict=True)
        ]
    )
    floor = np.maximum(noise / low, steps / np.sqrt(12))
    rounding = np.finfo(float).eps * np.abs(values).max(axis=0)
    return np.asarray(((deviation <= high * floor + rounding) & ~at_limit).all(axis=1))


def _window_deviations(values: Array, width: int) -> Array:
    """Return the (N - width + 1, C) standard deviations of all windows of `width` samples.

    Windows of 1, 2, 4, ... samples are merged (Chan, Golub, LeVeque 1983). Differences of running sums would
    hide deviations below 1e-7 of the largest value.
    """
    total = len(values) - width + 1
    mean, squares, count = np.zeros((total, values.shape[1])), np.zeros((total, values.shape[1])), 0
    block_mean, block_squares, block = values, np.zeros_like(values), 1
    while count < width:
        if width & block:
            new_mean, new_squares = block_mean[count : count + total], block_squares[count : count + total]
            difference = new_mean - mean
            squares += new_squares + difference**2 * (count * block / (count + block))
            mean += difference * (block / (count + block))
            count += block
        if count < width:
            difference = block_mean[block:] - block_mean[:-block]
            block_squares = block_squares[:-block] + block_squares[block:] + difference**2 * (block / 2)
            block_mean = (block_mean[:-block] + block_mean[block:]) / 2
            block *= 2
    return np.asarray(np.sqrt(squares / width))


def _find_segments(
    quiet: NDArray[np.bool_], width: int, gap: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and one-past-last sample of each segment covered by overlapping quiet windows.

    Two neighbouring samples are connected if one quiet window contains both, so a sudden change of pose
    separates segments even if quiet windows end and begin right at it. gap: (N - 1,) True where time
    jumps, which separates segments too.
    """
    count = len(gap) + 1
    coverage = np.zeros(count, np.int64)
    coverage[: len(quiet)] += quiet
    coverage[width - 1 :] -= quiet
    connected = (np.cumsum(coverage)[: count - 1] > 0) & ~gap
    edges = np.diff(np.concatenate([[0], connected.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) + 1


def _creep_reason(accel: Array) -> str:
    """Return the reason why a segment is not a standstill, or ""."""
    half = len(accel) // 2
    first, second = accel[:half], accel[half:]
    shift = np.abs(second.mean(axis=0) - first.mean(axis=0))
    # White noise is estimated from successive differences, so that the creep does not raise its own
    # threshold.
    error = np.diff(accel, axis=0).std(axis=0) / np.sqrt(half)
    if bool((shift > np.maximum(CREEP_SIGMA * error, CREEP_ACCELERATION)).any()):
        return f"gravity crept by {shift.max():.3f} m/s², so the node still moved"
    return ""
