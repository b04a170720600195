"""Standstills of a gyro during a heading measurement, and its angle random walk from them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError, InputError
from hubodo.recording import Table
from hubodo.sensors.imu.standstills import Standstills, find_standstills
from hubodo.sensors.north.stops import TableMotion, split_stops

Spans = tuple[tuple[int, int], ...]
"""Index of the first sample and one past the last of each standstill."""

_MIN_MEANS = 16
_MAX_BIAS_STEP, _MAX_BIAS_DRIFT_RATE, _BIAS_CHANGE_SIGMA = np.radians(0.02), np.radians(0.002), 6.0
"""Largest bias change between standstills: constant part, rad/s, per time, rad/s², and in sigmas.

A MEMS gyro of 0.05 deg/s/K that warms up by 10 degrees in five minutes drifts by 0.0017 deg/s².
"""


def standstills_from_user(t: Array, standstills: Sequence[Sequence[float]]) -> Spans:
    """Return the standstills given by the user, (from, to) in s of the log.

    Raise InputError for empty spans.
    """
    spans = []
    for start, end in sorted(map(tuple, standstills)):
        i, j = (int(k) for k in np.searchsorted(t, [start, end]))
        if j - i < 2:
            raise InputError(f"no samples between {start:g} and {end:g} s, given as a standstill with --rest")
        spans.append((i, j))
    if any(b[0] < a[1] for a, b in pairwise(spans)):
        raise InputError("two standstills given with --rest overlap; give each standstill once")
    return tuple(spans)


def detect_standstills(t: Array, gyro: Array, accel: Array, rate: Array, table: Table | None) -> Spans:
    """Return the standstills from the table file, else those with all six channels near their noise floor.

    t: (N,) s. gyro: (N, 3) rad/s. accel: (N, 3) m/s². rate: (N,) rate about the vertical, rad/s, to check
    the stops of the table. Empty if there is no standstill. Raises InputError if the table moved during a
    stop, or if the bias jumps between standstills.
    """
    if table is not None and bool((table["moving"] < 0.5).any()):
        motion = TableMotion(table.t, table["angle"], table["moving"] > 0.5)
        stops = split_stops(t, rate, motion, vertical=rate)
        return tuple(zip(map(int, stops.start), map(int, stops.end), strict=True))
    try:
        standstills = find_standstills(t, gyro, accel)
    except CalibrationError:
        return ()
    _check_bias_steps(t, rate, standstills)
    return tuple(zip(map(int, standstills.start), map(int, standstills.end), strict=True))


def _check_bias_steps(t: Array, rate: Array, standstills: Standstills) -> None:
    """Raise InputError if the bias jumps between standstills: steady motion can look like standstill."""
    spans = list(zip(map(int, standstills.start), map(int, standstills.end), strict=True))
    means = [float(rate[i:j].mean()) for i, j in spans]
    sigma = np.linalg.norm(standstills.gyro_sigma, axis=1)
    for k, ((_, end), (start, _)) in enumerate(pairwise(spans)):
        max_step = (
            _MAX_BIAS_STEP
            + _MAX_BIAS_DRIFT_RATE * (t[start] - t[end - 1])
            + _BIAS_CHANGE_SIGMA * float(np.hypot(sigma[k], sigma[k + 1]))
        )
        bias_step = abs(means[k + 1] - means[k])
        if bias_step > max_step:
            raise InputError(
                f"the standstills at {t[end - 1]:.1f} and {t[start]:.1f} s differ by "
                f"{np.degrees(bias_step):.2g} deg/s, more than a bias drifts: the node turned in one of "
                "them; give the true standstills with --rest FROM TO"
            )


def estimate_angle_random_walk(t: Array, rate: Array, spans: Spans) -> float | None:
    """Return N, rad/√s, from differences of adjacent means within standstills; None if these are too short.

    The means are over tau = 1 s, or a sixteenth of the longest standstill, so the bias does not drift
    between them. The result is their Allan deviation times √tau, corrected for the correlation of
    neighbouring means if the gyro's bandwidth is low.
    """
    step = float(np.median(np.diff(t)))
    longest = max((j - i for i, j in spans), default=0)
    width = min(max(1, round(1.0 / step)), longest // _MIN_MEANS)
    if width < 1:
        return None
    squares = []
    for i, j in spans:
        count = (j - i) // width
        squares.append(np.diff(rate[i : i + count * width].reshape(count, width).mean(axis=1)) ** 2)
    tau = width * step
    white_share = 1.0 - _bandwidth_reduction(rate, spans, step, tau)
    return float(np.sqrt(np.mean(np.concatenate(squares)) / 2.0 * tau / white_share)) or None


def _bandwidth_reduction(rate: Array, spans: Spans, step: float, tau: float) -> float:
    """Return the relative reduction of the Allan variance at tau s by a one-pole low-pass, at most one half.

    With the time constant T of the pole and x = T / tau (1 - e^(-tau / T)), a mean has the variance N² /
    tau (1 - x) and the covariance N² / tau x² tau / (2 T) with its neighbour. T follows from the
    correlation of neighbouring samples.
    """
    i, j = max(spans, key=lambda span: span[1] - span[0])
    residual = rate[i:j] - rate[i:j].mean()
    power = float(residual @ residual)
    correlation = float(residual[1:] @ residual[:-1]) / power if power else 0.0
    if correlation < 3.0 / np.sqrt(len(residual)):
        return 0.0
    pole = -step / np.log(min(correlation, 0.999))
    x = pole / tau * -np.expm1(-tau / pole)
    return float(min(x + 0.5 * x**2 * tau / pole, 0.5))
