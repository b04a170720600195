"""Azimuth of a turntable from Earth rate: maytagging, east-seeking and carouselling (Robert 2014).

A level gyro axis at angle a anticlockwise (seen from above) from table zero reads Omega cos(latitude)
cos(azimuth - a) beside its bias, azimuth being that of table zero, clockwise from north. The axes of a node
that stands upright with x along table zero: x at a = table angle, y a quarter turn further; one that hangs
upside down has y the other way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hubodo.earth import EARTH_RATE
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.north.circle import blind_axis, summarise
from hubodo.sensors.north.drift import Drift
from hubodo.sensors.north.filters import Classical, along, classical, opposite_pairs
from hubodo.sensors.north.ml import Averages, Posterior, average, estimate
from hubodo.sensors.north.stops import Stops, TableMotion, split_stops

Array = NDArray[np.float64]
Method = Literal["maytag", "maytag4", "carousel", "east"]
METHODS: tuple[Method, ...] = ("maytag", "maytag4", "carousel", "east")

MIN_STOPS = 4
MIN_HORIZONTAL = 0.05
"""Of Earth rate, at 2.9 degrees from the pole.

Nearer to it half a degree of tilt already outweighs what is left of it.
"""
AVERAGES = 240
PER_TURN = 16


@dataclass(frozen=True)
class North:
    """Azimuth of table zero and what it rests on.

    azimuth, sigma: rad, clockwise from north, of table zero. candidates: azimuths that the record cannot
    tell apart (two for stops along one line only). rates: rad/s, each single estimate of the component along
    `direction`, the angle of the first stop (east: each along its own). cross: those a quarter turn
    anticlockwise from it. duration: s of measurement, elapsed: with the turns. white_bound: rad, 1 sigma
    if the gyro had its white noise alone. filters: the classical ones beside.
    """

    method: Method
    azimuth: float
    sigma: float
    candidates: tuple[float, ...]
    direction: float
    rates: Array
    cross: Array
    duration: float
    elapsed: float
    horizontal: float
    white_bound: float
    posterior: Posterior
    filters: Mapping[str, Classical]
    stops: Stops | None
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
    t: Array,
    rate: Array,
    table: TableMotion,
    latitude: float,
    method: Method,
    *,
    mounting: float = 0.0,
    vertical: Array | None = None,
    settle: float | None = None,
    near: float | None = None,
    drift: Drift | None = None,
) -> North:
    """Find the azimuth of table zero.

    t: (N,) s. rate: (N,) rad/s of one level axis. mounting: rad, the axis anticlockwise from table zero at
    table angle zero. vertical: (N,) rad/s upwards, proves that stops were stops. near: rad, about where
    table zero points; decides between the two candidates of stops along one line. drift: that of the gyro
    where known; else it is fitted. Raises InputError: too few stops, directions missing for the method,
    latitude impossible, table moved while still.
    """
    horizontal = horizontal_rate(latitude)
    if method not in METHODS:
        raise InputError(f"method {method!r} is unknown; choose from {', '.join(METHODS)}")
    check_scale(rate)
    if method == "carousel":
        seen = _carouselled(t, rate, table, mounting)
    else:
        stops = split_stops(t, rate, table, vertical=vertical, settle=settle)
        seen = _stopped(t, rate, replace(stops, angle=stops.angle + mounting), method)
    posterior = estimate(seen.averages, horizontal, drift)
    azimuth, sigma, candidates = summarise(posterior, near)
    filters = {}
    if seen.stops is not None and method != "east":
        filters = classical(seen.stops, seen.direction, posterior.drift)
    return North(
        method=method,
        azimuth=azimuth,
        sigma=sigma,
        candidates=candidates,
        direction=seen.direction,
        rates=seen.rates,
        cross=seen.cross,
        duration=seen.duration,
        elapsed=seen.elapsed,
        horizontal=horizontal,
        # Half of the information of a level axis that looks all ways evenly is across the azimuth.
        white_bound=_white_bound(seen.averages, posterior.drift.n, azimuth, horizontal),
        posterior=posterior,
        filters=filters,
        stops=seen.stops,
        warnings=_doubts(candidates, sigma, near),
    )


@dataclass(frozen=True)
class _Seen:
    """What the axis felt of the Earth: averages for the likelihood, and single estimates as in `North`."""

    averages: Averages
    stops: Stops | None
    direction: float
    rates: Array
    cross: Array
    duration: float
    elapsed: float


def _carouselled(t: Array, rate: Array, table: TableMotion, mounting: float) -> _Seen:
    angle = table.angle_at(t) + mounting
    averages, duration = _carousel(t, rate, angle, table)
    rates, cross = _per_turn(averages, t, angle)
    return _Seen(averages, None, mounting, rates, cross, duration, duration)


def _stopped(t: Array, rate: Array, stops: Stops, method: Method) -> _Seen:
    averages, duration = _stops(t, rate, stops, method)
    direction = float(stops.angle[0])
    if method == "east":
        rates, cross = _turned_about(stops), np.zeros(0)
    else:
        rates, cross = (_single(stops, direction + quarter) for quarter in (0.0, np.pi / 2))
    elapsed = float(stops.t[-1, 1] - stops.t[0, 0])
    return _Seen(averages, stops, direction, rates, cross, duration, elapsed)


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


def check_scale(rate: Array) -> None:
    """Raises when the channel is constant or by its size no rate in rad/s."""
    if len(rate) < 100:
        raise InputError(f"the record has {len(rate)} samples; record minutes, not moments")
    if not np.ptp(rate):
        raise CalibrationError(
            "the gyro axis never changes: it is stuck or quantized away; use a finer range"
        )


def _stops(t: Array, rate: Array, stops: Stops, method: Method) -> tuple[Averages, float]:
    count = len(stops)
    if count < MIN_STOPS:
        raise InputError(
            f"{count} stops are too few; {method} needs {MIN_STOPS} at least, 18 to 20 are usual"
        )
    facing = along(stops.angle, float(stops.angle[0]))
    across = along(stops.angle, float(stops.angle[0]) + np.pi / 2)
    need = {"maytag": [facing], "maytag4": [facing, across], "east": []}[method]
    for kind in need:
        if not ((kind > 0).any() and (kind < 0).any()):
            seen = sorted({round(float(np.degrees(a)) % 360, 1) for a in stops.angle})
            raise InputError(
                f"{method} needs stops {'180 degrees apart' if method == 'maytag' else 'every 90 degrees'}; "
                f"the table stopped at {', '.join(map(str, seen[:8]))} degrees"
            )
    if method == "east" and not len(_turned_about(stops)):
        raise InputError("east-seeking needs pairs of stops 180 degrees apart; the table never turned about")
    parts = max(1, min(8, AVERAGES // count))
    spans = list(zip(map(int, stops.start), map(int, stops.end), strict=True))
    angle = np.zeros(len(t))
    for (i, j), a in zip(spans, stops.angle, strict=True):
        angle[i:j] = a
    mean = stops.duration / count
    return average(t, rate, angle, spans, mean / parts), stops.duration


def _carousel(t: Array, rate: Array, angle: Array, table: TableMotion) -> tuple[Averages, float]:
    inside = np.flatnonzero((t >= table.t[0]) & (t <= table.t[-1]))
    if len(inside) < 100:
        raise InputError("table.csv and the node have no time in common; put both on one clock")
    span = (int(inside[0]), int(inside[-1]) + 1)
    turns = float(np.ptp(angle[span[0] : span[1]])) / (2 * np.pi)
    if turns < 2:
        raise InputError(f"the table made {turns:.1f} turns; a carousel needs 2 at least, better 10")
    if (
        len(table.t) > 1
        and float(np.abs(np.diff(table.angle)).max()) > np.pi
        and np.abs(table.angle).max() <= 7
    ):
        # Wrapped angles are joined by the nearest way, which needs rows at less than half a turn.
        worst = float(np.abs(np.diff(np.unwrap(table.angle))).max())
        if worst > np.radians(150):
            raise InputError(
                "table.csv is too sparse to follow its wrapped angle; write a row every 10 degrees or less"
            )
    length = float(t[span[1] - 1] - t[span[0]])
    return average(t, rate, angle, [span], length / (turns * PER_TURN)), length


def _per_turn(averages: Averages, t: Array, angle: Array) -> tuple[Array, Array]:
    """C and S of each full turn by itself, with a bias and a slope of its own."""
    middle = (averages.start + averages.end) / 2
    turn = np.floor(np.abs(np.interp(middle, t, angle) - angle[0]) / (2 * np.pi)).astype(int)
    found = []
    for k in range(int(turn.max()) + 1):
        rows = turn == k
        if np.count_nonzero(rows) >= PER_TURN - 1:
            m = middle[rows]
            columns = np.column_stack([averages.cos[rows], averages.sin[rows], np.ones(len(m)), m - m.mean()])
            found.append(np.linalg.lstsq(columns, averages.y[rows], rcond=None)[0][:2])
    made = np.array(found).reshape(-1, 2)
    return made[:, 0], made[:, 1]


def _single(stops: Stops, direction: float) -> Array:
    sign = along(stops.angle, direction)
    chosen = sign != 0
    return opposite_pairs(sign[chosen]).rates(stops.mean[chosen])


def _turned_about(stops: Stops) -> Array:
    """Half differences of consecutive stops 180 degrees apart, each along the direction of its first stop."""
    about = np.cos(np.diff(stops.angle)) < -np.cos(np.radians(2.0))
    return np.asarray(-np.diff(stops.mean)[about] / 2)


def _white_bound(averages: Averages, n: float, azimuth: float, horizontal: float) -> float:
    """1 sigma of azimuth for white noise alone, at the true length.

    With even coverage sqrt(2/T) N / horizontal.
    """
    across = horizontal * (-np.sin(azimuth) * averages.cos + np.cos(azimuth) * averages.sin)
    length = averages.end - averages.start
    across = across - np.average(across, weights=length)
    information = float((across**2 * length).sum()) / n**2 if n > 0 else np.inf
    return float(1 / np.sqrt(information)) if information > 0 else float("inf")
