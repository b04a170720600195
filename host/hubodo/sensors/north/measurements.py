"""Earth rate measurements of one axis for any table motion: averages, and single estimates of the rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.north.averages import Averages, average_spans
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.carousel import average_carousel, fit_each_turn
from hubodo.sensors.north.filters import DIRECTION_TOLERANCE, find_opposite_pairs, stop_signs
from hubodo.sensors.north.stops import Stops, split_stops
from hubodo.sensors.north.table_clock import align_table

Method = Literal["maytag", "maytag4", "carousel", "east"]
METHODS: tuple[Method, ...] = ("maytag", "maytag4", "carousel", "east")

MIN_STOP_COUNT = 4
TARGET_AVERAGES = 240
_MAX_TOLERANCE = np.radians(20)


@dataclass(frozen=True)
class Measurements:
    """The Earth rate measurements of one axis.

    Attributes:
        averages: averages of each record, for the likelihood.
        stops: stops of each record; empty for a carousel.
        direction: angle of the first stop, rad.
        rates, rates_across: single estimates along `direction` and a quarter turn from it, rad/s.
        duration, elapsed: time of measurement, and time including turns, s.
        notes: one line for each part that is excluded or corrected.
    """

    averages: tuple[Averages, ...]
    stops: tuple[Stops, ...]
    direction: float
    rates: Array
    rates_across: Array
    duration: float
    elapsed: float
    notes: tuple[str, ...] = ()


def collect_measurements(records: Sequence[AxisRecord], method: Method, settle: float | None) -> Measurements:
    """Return the measurements of all records of one axis.

    settle: time cut at both ends of each stop, s; None to estimate it. Raises InputError for an unknown
    method, too few samples or stops, or missing directions; CalibrationError for an axis that is stuck.
    """
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown; choose from {', '.join(METHODS)}")
    for record in records:
        _check_rate(record.rate)
    if method == "carousel":
        return _merge([_measure_carousel(record) for record in records])
    measurements = _merge([_measure_stops(record, method, settle) for record in records])
    _check_stops(measurements, method)
    return measurements


def _merge(parts: Sequence[Measurements]) -> Measurements:
    return replace(
        parts[0],
        averages=tuple(stops for part in parts for stops in part.averages),
        stops=tuple(stops for part in parts for stops in part.stops),
        rates=np.concatenate([part.rates for part in parts]),
        rates_across=np.concatenate([part.rates_across for part in parts]),
        duration=sum(part.duration for part in parts),
        elapsed=sum(part.elapsed for part in parts),
        notes=tuple(note for part in parts for note in part.notes),
    )


def _measure_carousel(record: AxisRecord) -> Measurements:
    turns = average_carousel(record)
    fits = [fit_each_turn(averages, turn) for averages, turn in zip(turns.averages, turns.turn, strict=True)]
    rates, cross = (np.concatenate([fit[k] for fit in fits]) for k in (0, 1))
    elapsed = float(turns.averages[-1].end[-1] - turns.averages[0].start[0])
    return Measurements(
        turns.averages, (), record.mounting_angle, rates, cross, turns.duration, elapsed, turns.notes
    )


def _measure_stops(record: AxisRecord, method: Method, settle: float | None) -> Measurements:
    t, rate, table = record.t, record.rate, record.table
    notes: list[str] = []
    if record.vertical_rate is not None:
        table, notes = align_table(t, record.vertical_rate, table)
    stops = split_stops(t, rate, table, vertical=record.vertical_rate, settle=settle)
    stops = replace(stops, angle=stops.angle + record.mounting_angle)
    direction = float(stops.angle[0])
    parts = max(1, min(8, TARGET_AVERAGES // len(stops)))
    spans = list(zip(map(int, stops.start), map(int, stops.end), strict=True))
    angle, turned = np.zeros(len(t)), np.zeros(len(t))
    for (i, j), stop_angle, rotation in zip(spans, stops.angle, stops.angle_from_first, strict=True):
        angle[i:j] = stop_angle
        turned[i:j] = rotation if stops.scale_sigma else 0.0
    length = stops.duration / len(stops) / parts
    averages = average_spans(t, rate, angle, spans, length, turned, record.temperature)
    if method == "east":
        rates, cross = _half_turn_rates(stops), np.zeros(0)
    else:
        rates, cross = (_rates_along(stops, direction + quarter) for quarter in (0.0, np.pi / 2))
    elapsed = float(stops.t[-1, 1] - stops.t[0, 0])
    return Measurements((averages,), (stops,), direction, rates, cross, stops.duration, elapsed, tuple(notes))


def _check_rate(rate: Array) -> None:
    """Raise InputError for too few samples, CalibrationError for a constant channel."""
    if len(rate) < 100:
        raise InputError(f"the record has {len(rate)} samples; record for some minutes")
    if not np.ptp(rate):
        raise CalibrationError(
            "the gyro axis never changes: it is stuck or its resolution is too coarse; use a finer range"
        )


def _check_stops(measurements: Measurements, method: Method) -> None:
    """Raise InputError if there are too few stops, or if directions that the method needs are missing."""
    angles = np.concatenate([stops.angle for stops in measurements.stops])
    if len(angles) < MIN_STOP_COUNT:
        excluded = "".join(f"; {note}" for stops in measurements.stops for note in stops.notes)
        raise InputError(
            f"{len(angles)} stops are too few; {method} needs at least {MIN_STOP_COUNT}, 18 to 20 are usual"
            f"{excluded}"
        )
    tolerance = direction_tolerance(measurements.stops)
    along_first, across_first = (
        stop_signs(angles, float(angles[0]) + quarter, tolerance) for quarter in (0.0, np.pi / 2)
    )
    required = {"maytag": [along_first], "maytag4": [along_first, across_first], "east": []}[method]
    for signs in required:
        if not ((signs > 0).any() and (signs < 0).any()):
            angles_deg = sorted({round(float(np.degrees(stop_angle)) % 360, 1) for stop_angle in angles})
            raise InputError(
                f"{method} needs stops {'180 degrees apart' if method == 'maytag' else 'every 90 degrees'}; "
                f"the table stopped at {', '.join(map(str, angles_deg[:8]))} degrees"
            )
    if method == "east" and not len(measurements.rates):
        raise InputError("east seeking needs pairs of stops 180 degrees apart; the table made no half turn")


def direction_tolerance(stops: Sequence[Stops]) -> float:
    """Return the tolerance of a stop's direction, rad; larger if the gyro itself measured the angles."""
    angle_tolerance = max(
        (3 * one.scale_sigma * float(np.abs(one.angle_from_first).max()) for one in stops), default=0.0
    )
    return float(min(DIRECTION_TOLERANCE + angle_tolerance, _MAX_TOLERANCE))


def _rates_along(stops: Stops, direction: float) -> Array:
    sign = stop_signs(stops.angle, direction, direction_tolerance([stops]))
    used = sign != 0
    return find_opposite_pairs(sign[used]).rates(stops.mean[used])


def _half_turn_rates(stops: Stops) -> Array:
    """Return half differences of consecutive stops 180° apart, each along the direction of its first stop."""
    is_half_turn = np.cos(np.diff(stops.angle)) < -np.cos(direction_tolerance([stops]))
    return np.asarray(-np.diff(stops.mean)[is_half_turn] / 2)
