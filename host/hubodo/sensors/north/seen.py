"""What an axis felt of the Earth, however its table moved: averages, and single estimates of the rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.north.averages import Averages, average
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.carousel import carousel_averages, per_turn
from hubodo.sensors.north.filters import TOLERANCE, along, opposite_pairs
from hubodo.sensors.north.stops import Stops, split_stops

Method = Literal["maytag", "maytag4", "carousel", "east"]
METHODS: tuple[Method, ...] = ("maytag", "maytag4", "carousel", "east")

MIN_STOPS = 4
AVERAGES = 240
_MAX_TOLERANCE = np.radians(20)


@dataclass(frozen=True)
class Seen:
    """What the axis felt of the Earth: averages for the likelihood, and single estimates as in `North`."""

    averages: tuple[Averages, ...]
    stops: tuple[Stops, ...]
    direction: float
    rates: Array
    cross: Array
    duration: float
    elapsed: float


def look(records: Sequence[AxisRecord], method: Method, settle: float | None) -> Seen:
    """What records of one axis hold together.

    settle: s cut at both ends of each stop, None to find it. Raises InputError: an unknown method, too few
    samples or stops, directions missing for the method; CalibrationError for an axis that is stuck.
    """
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown; choose from {', '.join(METHODS)}")
    for record in records:
        _check_scale(record.rate)
    if method == "carousel":
        return _together([_carouselled(record) for record in records])
    seen = _together([_stopped(record, method, settle) for record in records])
    _check_stops(seen, method)
    return seen


def _together(parts: Sequence[Seen]) -> Seen:
    return replace(
        parts[0],
        averages=tuple(made for part in parts for made in part.averages),
        stops=tuple(made for part in parts for made in part.stops),
        rates=np.concatenate([part.rates for part in parts]),
        cross=np.concatenate([part.cross for part in parts]),
        duration=sum(part.duration for part in parts),
        elapsed=sum(part.elapsed for part in parts),
    )


def _carouselled(record: AxisRecord) -> Seen:
    averages, turn, duration = carousel_averages(record)
    rates, cross = per_turn(averages, turn)
    return Seen((averages,), (), record.mounting, rates, cross, duration, duration)


def _stopped(record: AxisRecord, method: Method, settle: float | None) -> Seen:
    t, rate = record.t, record.rate
    stops = split_stops(t, rate, record.table, vertical=record.vertical, settle=settle)
    stops = replace(stops, angle=stops.angle + record.mounting)
    direction = float(stops.angle[0])
    parts = max(1, min(8, AVERAGES // len(stops)))
    spans = list(zip(map(int, stops.start), map(int, stops.end), strict=True))
    angle, turned = np.zeros(len(t)), np.zeros(len(t))
    for (i, j), a, by in zip(spans, stops.angle, stops.turned, strict=True):
        angle[i:j] = a
        turned[i:j] = by if stops.scale_sigma else 0.0
    averages = average(t, rate, angle, spans, stops.duration / len(stops) / parts, turned)
    if method == "east":
        rates, cross = _turned_about(stops), np.zeros(0)
    else:
        rates, cross = (_single(stops, direction + quarter) for quarter in (0.0, np.pi / 2))
    elapsed = float(stops.t[-1, 1] - stops.t[0, 0])
    return Seen((averages,), (stops,), direction, rates, cross, stops.duration, elapsed)


def _check_scale(rate: Array) -> None:
    """Raises when the channel is constant or by its size no rate in rad/s."""
    if len(rate) < 100:
        raise InputError(f"the record has {len(rate)} samples; record minutes, not moments")
    if not np.ptp(rate):
        raise CalibrationError(
            "the gyro axis never changes: it is stuck or quantized away; use a finer range"
        )


def _check_stops(seen: Seen, method: Method) -> None:
    """Raises InputError where there are too few stops, or none that face the ways the method needs."""
    angles = np.concatenate([stops.angle for stops in seen.stops])
    if len(angles) < MIN_STOPS:
        raise InputError(
            f"{len(angles)} stops are too few; {method} needs {MIN_STOPS} at least, 18 to 20 are usual"
        )
    tolerance = tolerance_of(seen.stops)
    facing, across = (along(angles, float(angles[0]) + quarter, tolerance) for quarter in (0.0, np.pi / 2))
    need = {"maytag": [facing], "maytag4": [facing, across], "east": []}[method]
    for kind in need:
        if not ((kind > 0).any() and (kind < 0).any()):
            at = sorted({round(float(np.degrees(a)) % 360, 1) for a in angles})
            raise InputError(
                f"{method} needs stops {'180 degrees apart' if method == 'maytag' else 'every 90 degrees'}; "
                f"the table stopped at {', '.join(map(str, at[:8]))} degrees"
            )
    if method == "east" and not len(seen.rates):
        raise InputError("east-seeking needs pairs of stops 180 degrees apart; the table never turned about")


def tolerance_of(stops: Sequence[Stops]) -> float:
    """rad by which stops may miss a direction; more where the gyro felt the angles itself."""
    felt = max((3 * made.scale_sigma * float(np.abs(made.turned).max()) for made in stops), default=0.0)
    return float(min(TOLERANCE + felt, _MAX_TOLERANCE))


def _single(stops: Stops, direction: float) -> Array:
    sign = along(stops.angle, direction, tolerance_of([stops]))
    chosen = sign != 0
    return opposite_pairs(sign[chosen]).rates(stops.mean[chosen])


def _turned_about(stops: Stops) -> Array:
    """Half differences of consecutive stops 180 degrees apart, each along the direction of its first stop."""
    about = np.cos(np.diff(stops.angle)) < -np.cos(tolerance_of([stops]))
    return np.asarray(-np.diff(stops.mean)[about] / 2)
