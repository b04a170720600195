"""Standstills of a gyro during a heading measurement, and its angle random walk from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE, STANDARD_GRAVITY
from hubodo.errors import CalibrationError, InputError
from hubodo.recording import Table
from hubodo.sensors.heading.quiet_segments import QuietSegments, divide_quiet_segments
from hubodo.sensors.heading.standstill_choice import (
    MAX_BIAS,
    SURE_ODDS,
    StandstillChoice,
    choose_standstills,
)
from hubodo.sensors.heading.turn_evidence import turn_evidence
from hubodo.sensors.heading.vertical_axis import Spans, VerticalAxis
from hubodo.sensors.imu.standstills import find_standstills
from hubodo.sensors.north.stops import TableMotion, split_stops

_MIN_MEANS = 16
_START_S = 2.0
"""A standstill that begins within this time, s, is the beginning of the record."""
_TABLE_TILT = np.radians(0.1)
"""Usual tilt of a table's axis, rad."""
_LARGEST_RATE_QUANTILE = 0.995
"""Quantile of the rate that counts as its largest, so that a blow does not."""


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


@dataclass(frozen=True)
class DetectedStandstills:
    """Standstills found in a record.

    Attributes:
        spans: index range of each.
        notes: remarks on rejected segments and on doubtful choices, one line each.
        problem: reason why there is no standstill, or "".
    """

    spans: Spans
    notes: tuple[str, ...] = ()
    problem: str = ""


def detect_standstills(
    t: Array,
    gyro: Array,
    accel: Array,
    axis: VerticalAxis,
    index: int,
    expected_bias: Array,
    table: Table | None,
) -> DetectedStandstills:
    """Return the standstills from the table file, else the quiet segments that share one bias.

    t: (N,) s. gyro: (N, 3) rad/s. accel: (N, 3) m/s²; channels that were not measured are NaN. axis: the
    vertical one, column `index` of gyro. expected_bias: (N,) rad/s, by the warm-up model. Raises
    InputError if the table moved during a stop.
    """
    if table is not None and bool((table["moving"] < 0.5).any()):
        motion = TableMotion(table.t, table["angle"], table["moving"] > 0.5)
        stops = split_stops(t, axis.rate, motion, vertical=axis.rate)
        spans = tuple(zip(map(int, stops.start), map(int, stops.end), strict=True))
        return DetectedStandstills(spans, stops.notes)
    try:
        quiet = find_standstills(t, *fill_channels(axis.raw, gyro, accel), max_rate=np.inf)
    except CalibrationError:
        return DetectedStandstills(())
    rate = axis.rate - expected_bias
    quiet_spans = list(zip(map(int, quiet.start), map(int, quiet.end), strict=True))
    segments = divide_quiet_segments(t, rate, quiet_spans)
    evidence = None
    others = gyro[:, np.isfinite(gyro).all(axis=0) & (np.arange(3) != index)]
    biases = np.array([float(np.median(values)) for values in others.T if np.ptp(values) > 0.0])
    if len(segments) > 1:
        spans_of_rate = list(zip(segments.start.tolist(), segments.end.tolist(), strict=True))
        horizontal = _horizontal_channels(index, gyro, accel)
        evidence = turn_evidence(t, rate, horizontal, spans_of_rate, MAX_BIAS)
    largest_rate = float(np.quantile(np.abs(rate - np.median(rate)), _LARGEST_RATE_QUANTILE))
    largest_rate = max([largest_rate, *np.abs(segments.rate)])
    latest_start = int(np.searchsorted(t, t[0] + _START_S))
    choice = choose_standstills(segments, largest_rate, latest_start, biases, evidence)
    return _describe_choice(t, segments, choice)


def _describe_choice(t: Array, segments: QuietSegments, choice: StandstillChoice) -> DetectedStandstills:
    """Return the accepted standstills with remarks, or the reason why none is accepted."""

    def times(which: NDArray[np.bool_]) -> str:
        parts = [f"{t[i]:.1f}..{t[j - 1]:.1f}" for i, j in _merge_segments(segments, which)]
        return f"{', '.join(parts[:3])}{' and others' if len(parts) > 3 else ''} s"

    if not len(segments):
        return DetectedStandstills(())
    rates = np.degrees(segments.rate)
    if not choice.is_accepted:
        best = (
            f"; the most probable one is {times(choice.is_standstill)}" if choice.is_standstill.any() else ""
        )
        alternative = (
            f", but {times(choice.alternative)} may be one as well"
            if best and choice.alternative.any()
            else ""
        )
        return DetectedStandstills(
            (),
            problem=f"{len(segments)} segments have a constant rate ({rates.min():.2f} to {rates.max():.2f} "
            f"deg/s), and a steady turn looks like a standstill{best}{alternative}; give the true "
            "standstills with --rest FROM TO",
        )
    notes = []
    spans = _merge_segments(segments, choice.is_standstill)
    if choice.odds < SURE_ODDS and len(spans) == 1:
        notes.append(
            f"only its small rate ({np.degrees(choice.bias):+.3f} deg/s) distinguishes the standstill at "
            f"{times(choice.is_standstill)} from a steady turn (odds {choice.odds:.0f} to 1), as there is no "
            "other standstill and neither gravity nor Earth rate confirms it"
        )
    turns = ~choice.is_standstill
    if turns.any():
        notes.append(
            f"{len(_merge_segments(segments, turns))} segments with a constant rate are turns: {times(turns)}"
        )
    return DetectedStandstills(tuple(spans), tuple(notes))


def _merge_segments(segments: QuietSegments, which: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the index ranges of these segments, with adjacent ones merged."""
    spans: list[tuple[int, int]] = []
    for k in np.flatnonzero(which).tolist():
        i, j = int(segments.start[k]), int(segments.end[k])
        if spans and spans[-1][1] == i:
            spans[-1] = (spans[-1][0], j)
        else:
            spans.append((i, j))
    return spans


def fill_channels(rate: Array, gyro: Array, accel: Array) -> tuple[Array, Array]:
    """Return gyro and accelerometer (N, 3), with the vertical gyro in place of missing or stuck channels."""

    def fill(values: Array) -> Array:
        usable = np.isfinite(values).all(axis=0) & (np.ptp(values, axis=0) > 0.0)
        return np.where(usable, values, rate[:, None])

    return fill(gyro), fill(accel)


def _horizontal_channels(index: int, gyro: Array, accel: Array) -> list[tuple[Array, float]]:
    """Return the measured horizontal channels of gyro and accelerometer with the amplitudes to expect.

    index: column of the vertical axis.
    """
    triads = []
    for values, amplitude in ((gyro, EARTH_RATE), (accel, STANDARD_GRAVITY * _TABLE_TILT)):
        measured = np.isfinite(values).all(axis=0) & (np.arange(3) != index)
        triads.append((values[:, measured], float(amplitude)))
    return triads


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
