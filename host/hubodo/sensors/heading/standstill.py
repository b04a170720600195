"""When a gyro stood still while its heading was taken, and how white it was then."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError, InputError
from hubodo.recording import Table
from hubodo.sensors.imu.rests import Rests, find_rests
from hubodo.sensors.north.stops import TableMotion, split_stops

Spans = tuple[tuple[int, int], ...]
"""First sample and one past the last of each standstill."""

_FEWEST_MEANS = 16
_LEAP, _DRIFT, _SURE = np.radians(0.02), np.radians(0.002), 6.0
"""rad/s, rad/s² and sigma by which the bias may differ from standstill to standstill.

A MEMS gyro of 0.05 deg/s/K that warms up by 10 degrees in five minutes drifts by 0.0017 deg/s².
"""


def given_rests(t: Array, rests: Sequence[Sequence[float]]) -> Spans:
    """Those that the user names, (from, to) in s of the log. Raises InputError for a span without samples."""
    spans = []
    for begin, end in sorted(map(tuple, rests)):
        i, j = (int(k) for k in np.searchsorted(t, [begin, end]))
        if j - i < 2:
            raise InputError(f"no samples between {begin:g} and {end:g} s, where a rest was said to be")
        spans.append((i, j))
    if any(b[0] < a[1] for a, b in pairwise(spans)):
        raise InputError("two rests that were given overlap; give each standstill once")
    return tuple(spans)


def found_rests(t: Array, gyro: Array, accel: Array, rate: Array, table: Table | None) -> Spans:
    """Those that the table's file tells, else those in which all six channels stay near their noise floor.

    t: (N,) s. gyro: (N, 3) rad/s. accel: (N, 3) m/s². rate: (N,) rad/s, about the vertical, which proves that
    the table stood. Empty where it never rests. Raises InputError when the table moved while it was still, or
    the bias leaps between standstills.
    """
    if table is not None and bool((table["moving"] < 0.5).any()):
        motion = TableMotion(table.t, table["angle"], table["moving"] > 0.5)
        stops = split_stops(t, rate, motion, vertical=rate)
        return tuple(zip(map(int, stops.start), map(int, stops.end), strict=True))
    try:
        rests = find_rests(t, gyro, accel)
    except CalibrationError:
        return ()
    _check_agreement(t, rate, rests)
    return tuple(zip(map(int, rests.start), map(int, rests.end), strict=True))


def _check_agreement(t: Array, rate: Array, rests: Rests) -> None:
    """Raises InputError where the bias leaps from one standstill to the next: a smooth ride is no rest."""
    spans = list(zip(map(int, rests.start), map(int, rests.end), strict=True))
    means = [float(rate[i:j].mean()) for i, j in spans]
    sigma = np.linalg.norm(rests.gyro_sigma, axis=1)
    for k, ((_, end), (start, _)) in enumerate(pairwise(spans)):
        bound = _LEAP + _DRIFT * (t[start] - t[end - 1]) + _SURE * float(np.hypot(sigma[k], sigma[k + 1]))
        leap = abs(means[k + 1] - means[k])
        if leap > bound:
            raise InputError(
                f"the standstills at {t[end - 1]:.1f} and {t[start]:.1f} s differ by "
                f"{np.degrees(leap):.2g} deg/s, more than a bias moves: the node turned in one of them; say "
                "when it truly stood with --rest FROM TO"
            )


def angle_random_walk(t: Array, rate: Array, spans: Spans) -> float | None:
    """N, rad/√s, from how neighbouring means within the standstills differ; None where they are too short.

    The means are over a second, or a sixteenth of the longest standstill: short enough for the bias not to
    move. This is the Allan deviation there, times √tau, and more by what neighbouring means share where the
    gyro's bandwidth is low (`_shared`).
    """
    step = float(np.median(np.diff(t)))
    longest = max((j - i for i, j in spans), default=0)
    width = min(max(1, round(1.0 / step)), longest // _FEWEST_MEANS)
    if width < 1:
        return None
    squares = []
    for i, j in spans:
        count = (j - i) // width
        squares.append(np.diff(rate[i : i + count * width].reshape(count, width).mean(axis=1)) ** 2)
    tau = width * step
    left = 1.0 - _shared(rate, spans, step, tau)
    return float(np.sqrt(np.mean(np.concatenate(squares)) / 2.0 * tau / left)) or None


def _shared(rate: Array, spans: Spans, step: float, tau: float) -> float:
    """By how much, relative, noise of one pole makes means over tau s differ less than white noise would.

    With the time constant T of the pole and x = T / tau (1 - e^(-tau / T)), a mean has the variance
    N² / tau (1 - x) and shares N² / tau x² tau / (2 T) with its neighbour. T is that of the correlation of
    samples that follow each other; at most half is believed.
    """
    i, j = max(spans, key=lambda span: span[1] - span[0])
    rest = rate[i:j] - rate[i:j].mean()
    power = float(rest @ rest)
    alike = float(rest[1:] @ rest[:-1]) / power if power else 0.0
    if alike < 3.0 / np.sqrt(len(rest)):
        return 0.0
    pole = -step / np.log(min(alike, 0.999))
    x = pole / tau * -np.expm1(-tau / pole)
    return float(min(x + 0.5 * x**2 * tau / pole, 0.5))
