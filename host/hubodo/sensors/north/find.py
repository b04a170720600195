"""Azimuth of a turntable from Earth rate: maytagging, east-seeking and carouselling (Robert 2014).

A level gyro axis at angle a anticlockwise (seen from above) from table zero reads Omega cos(latitude)
cos(azimuth - a) beside its bias, azimuth being that of table zero, clockwise from north. The axes of a node
that stands upright with x along table zero: x at a = table angle, y a quarter turn further; one that hangs
upside down has y the other way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hubodo.earth import EARTH_RATE
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.north.averages import Averages, average
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.carousel import carousel_averages, per_turn
from hubodo.sensors.north.circle import blind_axis, summarise
from hubodo.sensors.north.drift import Drift
from hubodo.sensors.north.filters import TOLERANCE, Classical, along, classical, opposite_pairs
from hubodo.sensors.north.ml import Posterior, azimuth_bound, estimate
from hubodo.sensors.north.stops import Stops, split_stops

Array = NDArray[np.float64]
Method = Literal["maytag", "maytag4", "carousel", "east"]
METHODS: tuple[Method, ...] = ("maytag", "maytag4", "carousel", "east")

MIN_STOPS = 4
MIN_HORIZONTAL = 0.05
"""Of Earth rate, at 2.9 degrees from the pole.

Nearer to it half a degree of tilt already outweighs what is left of it.
"""
AVERAGES = 240
_MAX_TOLERANCE = np.radians(20)


@dataclass(frozen=True)
class North:
    """Azimuth of table zero and what it rests on.

    azimuth, sigma: rad, clockwise from north, of table zero. angle_sigma: what of sigma comes from angles
    that the gyro felt itself. candidates: azimuths that the records cannot tell apart (two for stops along
    one line only). rates: rad/s, each single estimate of the component along `direction`, the angle of the
    first stop (east: each along its own). cross: those a quarter turn anticlockwise from it. duration: s of
    measurement, elapsed: with the turns. horizontal: rad/s that the axis feels when it points north. bound:
    rad, Cramér-Rao's for the gyro's noise, given or fitted, with these stops; white_bound: if it had its
    white noise alone. filters: the classical ones, of one record, beside.
    """

    method: Method
    azimuth: float
    sigma: float
    angle_sigma: float
    candidates: tuple[float, ...]
    direction: float
    rates: Array
    cross: Array
    duration: float
    elapsed: float
    horizontal: float
    bound: float
    white_bound: float
    posterior: Posterior
    filters: Mapping[str, Classical]
    stops: tuple[Stops, ...]
    averages: tuple[Averages, ...]
    warnings: tuple[str, ...] = ()

    def components(self) -> tuple[Array, Array]:
        """The likelihood's rate and its sigma, rad/s, in the components that the classical filters give."""
        rate, spread = self.posterior.rate, self.posterior.rate_covariance
        if blind_axis(self.posterior) is not None:
            line = np.array([[np.cos(self.direction), np.sin(self.direction)]])
            return np.asarray(line @ rate), np.asarray(np.sqrt(np.diag(line @ spread @ line.T)))
        return rate, np.asarray(np.sqrt(np.diag(spread)))


def horizontal_rate(latitude: float) -> float:
    """Omega cos(latitude), rad/s. Raises InputError for a latitude (rad) out of range or too near a pole."""
    if not abs(latitude) <= np.pi / 2:
        raise InputError(
            f"latitude {np.degrees(latitude):.6g} degrees is out of range; give -90 to 90 degrees"
        )
    if np.cos(latitude) < MIN_HORIZONTAL:
        raise InputError(
            f"latitude {np.degrees(latitude):.6g} degrees is too near the pole: "
            f"{100 * np.cos(latitude):.1f} % of Earth "
            "rate is level there, and tilt outweighs it; use another way to find north"
        )
    return EARTH_RATE * float(np.cos(latitude))


def find_north(
    records: Sequence[AxisRecord],
    latitude: float,
    method: Method,
    *,
    settle: float | None = None,
    near: float | None = None,
    drift: Drift | None = None,
) -> North:
    """Find the azimuth of table zero from one record of an axis, or from several that share table zero.

    latitude: rad. settle: s cut at both ends of each stop, None to find it. near: rad, about where table zero
    points; decides between the two candidates of stops along one line. drift: that of the gyro where known;
    else it is fitted. Raises InputError: too few stops, directions missing for the method, latitude
    impossible, table moved while still.
    """
    level = float(np.mean([record.level for record in records]))
    horizontal = horizontal_rate(latitude) * level
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown; choose from {', '.join(METHODS)}")
    for record in records:
        check_scale(record.rate)
    if method == "carousel":
        seen = _together([_carouselled(record) for record in records])
    else:
        seen = _together([_stopped(record, method, settle) for record in records])
        _check_stops(seen, method)
    scale_sigma = max((stops.scale_sigma for stops in seen.stops), default=0.0)
    posterior = estimate(seen.averages, horizontal, drift, scale_sigma)
    azimuth, sigma, candidates = summarise(posterior, near)
    angle_variance, of_turns = _angle_variance(posterior, seen, azimuth, horizontal)
    filters = {}
    if len(seen.stops) == 1 and method != "east":
        filters = classical(seen.stops[0], seen.direction, posterior.drift, _tolerance(seen.stops))
    sigma = float(np.hypot(sigma, np.sqrt(of_turns)))
    angle_sigma = float(np.sqrt(angle_variance + of_turns))
    return North(
        method=method,
        azimuth=azimuth,
        sigma=sigma,
        angle_sigma=angle_sigma,
        candidates=candidates,
        direction=seen.direction,
        rates=seen.rates,
        cross=seen.cross,
        duration=seen.duration,
        elapsed=seen.elapsed,
        horizontal=horizontal,
        bound=azimuth_bound(seen.averages, posterior.drift, azimuth, horizontal),
        white_bound=_white_bound(seen.averages, posterior.drift.n, azimuth, horizontal),
        posterior=posterior,
        filters=filters,
        stops=seen.stops,
        averages=seen.averages,
        warnings=(
            *(note for stops in seen.stops for note in stops.notes),
            *_doubts(candidates, sigma, near),
            *_more_noise(drift, posterior),
            *_felt(angle_sigma, sigma),
        ),
    )


@dataclass(frozen=True)
class _Seen:
    """What the axis felt of the Earth: averages for the likelihood, and single estimates as in `North`."""

    averages: tuple[Averages, ...]
    stops: tuple[Stops, ...]
    direction: float
    rates: Array
    cross: Array
    duration: float
    elapsed: float


def _together(parts: Sequence[_Seen]) -> _Seen:
    return replace(
        parts[0],
        averages=tuple(made for part in parts for made in part.averages),
        stops=tuple(made for part in parts for made in part.stops),
        rates=np.concatenate([part.rates for part in parts]),
        cross=np.concatenate([part.cross for part in parts]),
        duration=sum(part.duration for part in parts),
        elapsed=sum(part.elapsed for part in parts),
    )


def _carouselled(record: AxisRecord) -> _Seen:
    averages, turn, duration = carousel_averages(record)
    rates, cross = per_turn(averages, turn)
    return _Seen((averages,), (), record.mounting, rates, cross, duration, duration)


def _stopped(record: AxisRecord, method: Method, settle: float | None) -> _Seen:
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
    return _Seen((averages,), (stops,), direction, rates, cross, stops.duration, elapsed)


def _doubts(candidates: tuple[float, ...], sigma: float, near: float | None) -> tuple[str, ...]:
    """A line for two azimuths that cannot be told apart, and for an answer that is none."""
    warnings = []
    if len(candidates) > 1:
        both = " and ".join(f"{np.degrees(c):.2f}" for c in candidates)
        choice = (
            "add stops across, or say which is near"
            if near is None
            else "the nearer to the one given was taken"
        )
        warnings.append(f"stops along one line leave two azimuths: {both} degrees; {choice}")
    if sigma > np.radians(45):
        warnings.append("this record does not show north: the uncertainty is as large as the answer")
    return tuple(warnings)


def _felt(angle_sigma: float, sigma: float) -> tuple[str, ...]:
    if angle_sigma < 0.7 * sigma:
        return ()
    return (
        f"{np.degrees(angle_sigma):.1f} degrees of sigma come from angles that the gyro felt; give "
        "table.csv, say with --step-deg where the table stops, or turn it back the way it came",
    )


def _more_noise(given: Drift | None, posterior: Posterior) -> tuple[str, ...]:
    if given is None or posterior.drift.n == given.n:
        return ()
    times = posterior.drift.n / given.n
    return (f"the record is {times:.1f} times as noisy as --allan says, and sigma is widened by that",)


def check_scale(rate: Array) -> None:
    """Raises when the channel is constant or by its size no rate in rad/s."""
    if len(rate) < 100:
        raise InputError(f"the record has {len(rate)} samples; record minutes, not moments")
    if not np.ptp(rate):
        raise CalibrationError(
            "the gyro axis never changes: it is stuck or quantized away; use a finer range"
        )


def _check_stops(seen: _Seen, method: Method) -> None:
    """Raises InputError where there are too few stops, or none that face the ways the method needs."""
    angles = np.concatenate([stops.angle for stops in seen.stops])
    if len(angles) < MIN_STOPS:
        raise InputError(
            f"{len(angles)} stops are too few; {method} needs {MIN_STOPS} at least, 18 to 20 are usual"
        )
    tolerance = _tolerance(seen.stops)
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


def _tolerance(stops: Sequence[Stops]) -> float:
    """rad by which stops may miss a direction; more where the gyro felt the angles itself."""
    felt = max((3 * made.scale_sigma * float(np.abs(made.turned).max()) for made in stops), default=0.0)
    return float(min(TOLERANCE + felt, _MAX_TOLERANCE))


def _single(stops: Stops, direction: float) -> Array:
    sign = along(stops.angle, direction, _tolerance([stops]))
    chosen = sign != 0
    return opposite_pairs(sign[chosen]).rates(stops.mean[chosen])


def _turned_about(stops: Stops) -> Array:
    """Half differences of consecutive stops 180 degrees apart, each along the direction of its first stop."""
    about = np.cos(np.diff(stops.angle)) < -np.cos(_tolerance([stops]))
    return np.asarray(-np.diff(stops.mean)[about] / 2)


def _angle_variance(
    posterior: Posterior, seen: _Seen, azimuth: float, horizontal: float
) -> tuple[float, float]:
    """rad² of azimuth from the scale of angles that the gyro felt, and from what each turn adds besides."""
    across = np.array([-np.sin(azimuth), np.cos(azimuth)])
    of_scale = float(across @ posterior.angle_covariance @ across) / horizontal**2
    of_turns = 0.0
    for stops in seen.stops:
        # A stop tells of the azimuth as much as it looks east or west; its angle is off by all turns so far.
        weight = np.sin(azimuth - stops.angle) ** 2 * (stops.t[:, 1] - stops.t[:, 0])
        weight = weight / max(float(weight.sum()), 1e-300)
        later = np.cumsum(weight[::-1])[::-1][1:]
        of_turns += stops.turn_sigma**2 * float((later**2).sum())
    return of_scale, float(of_turns)


def _white_bound(records: Sequence[Averages], n: float, azimuth: float, horizontal: float) -> float:
    """1 sigma of azimuth for white noise alone, at the true length.

    With even coverage sqrt(2/T) N / horizontal: half of the information of a level axis that looks all ways
    evenly is across the azimuth.
    """
    information = 0.0
    for averages in records:
        across = horizontal * (-np.sin(azimuth) * averages.cos + np.cos(azimuth) * averages.sin)
        length = averages.end - averages.start
        across = across - np.average(across, weights=length)
        information += float((across**2 * length).sum()) / n**2 if n > 0 else np.inf
    return float(1 / np.sqrt(information)) if information > 0 else float("inf")
