"""Motion of a turntable from the gyro on it alone: times and angles of turns and stops."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from hubodo.arrays import Array, find_runs
from hubodo.errors import InputError
from hubodo.sensors.north.stops import TableMotion

Mask = NDArray[np.bool_]

MOTION_DETECTORS = ((0.2, np.radians(0.25)), (2.0, np.radians(0.04)))
"""(averaging time in s, smallest rate in rad/s): means above this rate and above TURN_SIGMA belong to a turn.

Fast turns are detected in short means, slow turns in long means of the remaining samples. The smallest
rates exceed the change of a gyro bias from stop to stop.
"""
TURN_SIGMA = 8.0
BIAS_WINDOW_S, MAX_BIAS_DRIFT = 30.0, np.radians(1.0)
"""The bias is estimated every BIAS_WINDOW_S in three times that window.

Its drift is below MAX_BIAS_DRIFT, rad/s.
"""
MIN_STOP_GAP_S = 0.6
"""Turns separated by less than this are merged."""
TURN_BIAS_S = 10.0
"""Length of the stops before and after a turn whose means give the bias during the turn."""
STOP_MARGIN_S = 1.5
"""Part at either end of a stop that may contain the undetected ends of a slow turn."""
MAX_HIDDEN_S = 3.0
ROW_SPACING = np.radians(30)
MAX_TABLE_LEAN = np.radians(20.0)
_MODE_SHARE_OF_SAMPLES = 0.2
_MAX_OFF_AXIS_SHARE, _MAX_OFF_AXIS_ANGLE = 0.1, np.radians(3.0)
_TABLE_STEP_TOLERANCE = np.radians(1.0)


@dataclass(frozen=True)
class TableTurn:
    """A turn of the table.

    Attributes:
        first, last: index of the first sample and one past the last.
        rotation: (3,) rotation in node axes, rad.
        path: (last - first, 3) cumulative rotation within the turn, rad.
        sigma: sigma of the turn angle without the scale error, rad.
    """

    first: int
    last: int
    rotation: Array
    path: Array
    sigma: float

    def table_rows(self, t: Array, axis: Array, start: float, end: float) -> list[tuple[float, float, float]]:
        """Return rows (t, angle, moving) as in a table file, about every ROW_SPACING, between two angles."""
        progress = self.path @ axis / float(self.rotation @ axis)
        count = max(2, int(abs(end - start) / ROW_SPACING) + 1)
        indices = np.linspace(0, len(progress) - 1, count).astype(int)
        return [(float(t[self.first + k]), start + (end - start) * float(progress[k]), 1.0) for k in indices]


def find_table_motion(
    t: Array,
    gyro: Array,
    up: Array,
    *,
    scale_sigma: float,
    step: float | None = None,
    max_rate: float = np.inf,
) -> TableMotion:
    """Return the motion of the table, with its angle relative to the first stop.

    t: (N,) s. gyro: (N, 3) rad/s. up: (3,) unit vector in node axes. scale_sigma: relative sigma of the
    gyro's scale factor. step: rad, for a table that only stops at multiples of this angle; its angles are
    then exact. max_rate: rad/s, at which samples are saturated. Raises InputError, with the time, if there is
    no turn, for turns about another axis, angles that are not multiples of step, a gap in a turn, and a turn
    too fast for the gyro.
    """
    moving = _detect_motion(t, gyro)
    turns = _integrate_turns(t, gyro, moving)
    if not turns:
        raise InputError(
            "the table never turned from one stop to another (a continuously turning one needs "
            "table.csv); north needs stops in different directions, or --simulate-azimuth-deg to test "
            "with a stationary gyro"
        )
    if step is None:
        _check_clipped(t, gyro, turns, max_rate)
    axis = _table_axis(t, turns, up)
    by = np.array([float(turn.rotation @ axis) for turn in turns])
    angle = np.concatenate([[0.0], np.cumsum(by)])
    if step is not None:
        angle, scale_sigma = _round_to_steps(t, turns, by, step, scale_sigma), 0.0
    sigma = float(np.sqrt(np.mean([turn.sigma**2 for turn in turns]))) if step is None else 0.0
    rows = [(float(t[0]), 0.0, 0.0)] if turns[0].first else []
    for turn, start, end in zip(turns, angle[:-1], angle[1:], strict=True):
        rows += turn.table_rows(t, axis, start, end)
        if turn.last < len(t):
            rows.append((float(t[turn.last]), end, 0.0))
    columns = np.array(rows)
    return TableMotion(columns[:, 0], columns[:, 1], columns[:, 2] > 0.5, scale_sigma, sigma)


def _detect_motion(t: Array, gyro: Array) -> Mask:
    """Return (N,) True where the table moves, with the resolution of the shortest mean."""
    step = float(np.median(np.diff(t)))
    moving = np.zeros(len(t), bool)
    base = _estimate_bias(gyro, step)
    for seconds, min_rate in MOTION_DETECTORS:
        width = max(1, round(seconds / step))
        significant = np.zeros(len(t), bool)
        for i, j in find_runs(~moving):
            segment_bias = np.median(gyro[i:j], axis=0) if moving.any() else base[i:j]
            significant[i:j] = _find_significant_means(gyro[i:j] - segment_bias, width, min_rate)
        moving |= significant
    return _extend_turns(_bridge_gaps(moving, round(MIN_STOP_GAP_S / step)), gyro - base, step)


def _check_clipped(t: Array, gyro: Array, turns: list[TableTurn], limit: float) -> None:
    for turn in turns:
        if np.abs(gyro[turn.first : turn.last]).max() >= limit:
            raise InputError(
                f"the gyro is saturated in the turn at {t[turn.first]:.1f} s, so the angle is unknown; "
                "turn more slowly, provide table.csv, or give the step of the table with --step-deg"
            )


def _estimate_bias(gyro: Array, step: float) -> Array:
    """Return the (N, 3) drifting bias, rad/s, from the most frequent rates of each window of about a minute.

    In a window in which the table hardly stopped, the most frequent rate is that of a turn; such windows
    are ignored.
    """
    width = max(1, round(MOTION_DETECTORS[0][0] / step))
    means = _block_means(gyro, width)
    overall_bias = np.array([_estimate_mode(channel) for channel in means.T])
    hop_blocks = max(1, round(BIAS_WINDOW_S / (width * step)))
    at, significant = [], []
    for i in range(0, max(1, len(means) - hop_blocks), hop_blocks):
        window_bias = np.array([_estimate_mode(channel) for channel in means[i : i + 3 * hop_blocks].T])
        if np.linalg.norm(window_bias - overall_bias) < MAX_BIAS_DRIFT:
            at.append((i + min(1.5 * hop_blocks, (len(means) - i) / 2)) * width)
            significant.append(window_bias)
    if not significant:
        return np.tile(overall_bias, (len(gyro), 1))
    rows = np.arange(len(gyro))
    return np.column_stack([np.interp(rows, at, channel) for channel in np.array(significant).T])


def _find_significant_means(deviation: Array, width: int, min_rate: float) -> Mask:
    """Return (N,) True for samples of means that differ significantly from zero."""
    rows = np.zeros(len(deviation), bool)
    means = _block_means(deviation, width)
    if len(means) < 3:
        return rows
    steps = np.diff(means, axis=0)
    noise = float(np.linalg.norm(1.4826 * np.median(np.abs(steps), axis=0))) / np.sqrt(2)
    is_significant = np.linalg.norm(means, axis=1) > max(min_rate, TURN_SIGMA * noise)
    # A turn that starts late within a mean is not detected there, so neighbouring means are included.
    extended = is_significant.copy()
    extended[:-1] |= is_significant[1:]
    extended[1:] |= is_significant[:-1]
    rows[: len(extended) * width] = np.repeat(extended, width)
    rows[len(extended) * width :] = bool(extended[-1])
    return rows


def _block_means(values: Array, width: int) -> Array:
    complete = len(values) // width * width
    return np.asarray(values[:complete].reshape(-1, width, values.shape[1]).mean(axis=1))


def _estimate_mode(values: Array) -> float:
    """Return the mode of the values: the mean of the shortest interval with a fifth of them."""
    ordered = np.sort(values)
    count = max(2, int(_MODE_SHARE_OF_SAMPLES * len(ordered)))
    if len(ordered) <= count:
        return float(np.median(ordered))
    at = int((ordered[count:] - ordered[:-count]).argmin())
    return float(ordered[at : at + count].mean())


def _bridge_gaps(moving: Mask, width: int) -> Mask:
    rows = moving.copy()
    for (_, end), (start, _) in pairwise(find_runs(moving)):
        if start - end < width:
            rows[end:start] = True
    return rows


def _extend_turns(moving: Mask, deviation: Array, step: float) -> Mask:
    """Return the mask extended by the undetected ends of turns, for a rate profile of a squared sine.

    Such a rate is below a share s of its peak for the first arcsin(sqrt(s)) / pi of the turn. deviation: rate
    minus bias, rad/s.
    """
    rows = moving.copy()
    for i, j in find_runs(moving):
        peak = 2 * float(np.linalg.norm(deviation[i:j].mean(axis=0)))
        undetected = np.arcsin(np.sqrt(min(1.0, MOTION_DETECTORS[0][1] / max(peak, 1e-9)))) / np.pi * (j - i)
        bias_samples = round(min(undetected, MAX_HIDDEN_S / step))
        rows[max(0, i - bias_samples) : j + bias_samples] = True
    return rows


def _integrate_turns(t: Array, gyro: Array, moving: Mask) -> list[TableTurn]:
    step = float(np.median(np.diff(t)))
    stops = find_runs(~moving)
    bias_samples, off_axis = round(TURN_BIAS_S / step), round(STOP_MARGIN_S / step)
    before, after, margin = {}, {}, {}
    for i, j in stops:
        # The slow ends of a turn, which are not detected, must not enter the bias.
        margin[i] = margin[j] = deviation = min(off_axis, (j - i) // 4)
        before[j] = gyro[max(i + deviation, j - deviation - bias_samples) : j - deviation].mean(axis=0)
        after[i] = gyro[i + deviation : min(j - deviation, i + deviation + bias_samples)].mean(axis=0)
    spans = find_runs(moving)
    bias_steps = [np.linalg.norm(after[j] - before[i]) for i, j in spans if i in before and j in after]
    drift = float(np.sqrt(np.mean(np.square(bias_steps)))) / 2 if bias_steps else 0.0
    density = _white_noise_density(gyro, stops, step)
    rows = []
    for i, j in spans:
        first, last = max(0, i - 1), min(j + 1, len(t))
        if float(np.diff(t[first:last]).max(initial=0.0)) > max(5 * step, 0.1):
            raise InputError(
                f"samples are missing in the turn at {t[i]:.1f} s, so its angle is unknown; provide "
                "table.csv or repeat the recording"
            )
        bias = (before.get(i, after.get(j, 0.0)) + after.get(j, before.get(i, 0.0))) / 2
        first, last = max(0, i - margin.get(i, 0)), min(j + margin.get(j, 0), len(t))
        path = cumulative_trapezoid(gyro[first:last] - bias, t[first:last], axis=0, initial=0)
        length = float(t[last - 1] - t[first])
        sigma = float(np.hypot(density * np.sqrt(length), drift * length))
        rows.append(TableTurn(i, j, path[-1], path[i - first : j - first], sigma))
    return rows


def _white_noise_density(gyro: Array, stops: list[tuple[int, int]], step: float) -> float:
    """Return the largest white noise of the axes, rad/√s, from 0.2 s means during the stops."""
    width = max(1, round(MOTION_DETECTORS[0][0] / step))
    steps = [np.diff(_block_means(gyro[i:j], width), axis=0) for i, j in stops if j - i >= 3 * width]
    if not steps:
        return 0.0
    differences = np.concatenate(steps)
    return float(np.sqrt(np.median(differences**2, axis=0).max() / 0.4549 / 2 * width * step))


def _table_axis(t: Array, turns: list[TableTurn], up: Array) -> Array:
    """Return the (3,) upward table axis in node axes; raise InputError if the turns have no common axis."""
    by = np.array([turn.rotation for turn in turns])
    axis = np.linalg.eigh(by.T @ by)[1][:, -1]
    lean = float(np.arccos(min(1.0, abs(float(axis @ up)))))
    if lean > MAX_TABLE_LEAN:
        raise InputError(
            f"the table turns about an axis tilted by {np.degrees(lean):.0f} degrees from the vertical, so "
            "the gyro's g-sensitivity exceeds Earth rate; level the table"
        )
    axis = np.asarray(axis * np.sign(axis @ up))
    for turn in turns:
        off_axis = float(np.linalg.norm(turn.rotation - (turn.rotation @ axis) * axis))
        if off_axis > max(_MAX_OFF_AXIS_SHARE * float(np.linalg.norm(turn.rotation)), _MAX_OFF_AXIS_ANGLE):
            raise InputError(
                f"at {t[turn.first]:.1f} s the node turned by {np.degrees(off_axis):.0f} degrees about "
                "another axis than the table's; cut the recording before or after it, or repeat it"
            )
    return axis


def _round_to_steps(t: Array, turns: list[TableTurn], by: Array, step: float, scale_sigma: float) -> Array:
    """Return the (turns + 1,) angles, rad, rounded to multiples of step, except turns far below a step."""
    angle = [0.0]
    for turn, measured in zip(turns, by, strict=True):
        reached = angle[-1] + float(measured)
        complete = step * round(reached / step)
        if abs(measured) < step / 4:
            angle.append(reached)
            continue
        if abs(reached - complete) > min(3 * scale_sigma * abs(measured) + _TABLE_STEP_TOLERANCE, step / 3):
            raise InputError(
                f"the turn at {t[turn.first]:.1f} s was {np.degrees(measured):.1f} degrees, to "
                f"{np.degrees(reached):.1f}, which is not a multiple of {np.degrees(step):g}; omit "
                "--step-deg or give the step of the table"
            )
        angle.append(complete)
    return np.array(angle)
