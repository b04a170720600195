"""Azimuth of a turntable from Earth rate: maytagging, east-seeking and carouselling (Robert 2014).

A level gyro axis at angle a anticlockwise (seen from above) from table zero reads Omega cos(latitude)
cos(azimuth - a) beside its bias, azimuth being that of table zero, clockwise from north. The axes of a node
that stands upright with x along table zero: x at a = table angle, y a quarter turn further; one that hangs
upside down has y the other way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE
from hubodo.errors import InputError
from hubodo.sensors.north.averages import Averages
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.circle import blind_axis, summarise
from hubodo.sensors.north.drift import Drift
from hubodo.sensors.north.filters import Classical, classical
from hubodo.sensors.north.ml import Posterior, azimuth_bound, estimate
from hubodo.sensors.north.seen import Method, Seen, look, tolerance_of
from hubodo.sensors.north.stops import Stops

MIN_HORIZONTAL = 0.05
"""Of Earth rate, at 2.9 degrees from the pole.

Nearer to it half a degree of tilt already outweighs what is left of it.
"""


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
        axis = blind_axis(self.posterior)
        if axis is not None:
            # The line that was measured to the last digit: what is across it is not known at all.
            line = np.array([[np.cos(axis), np.sin(axis)]]) * np.copysign(1.0, np.cos(axis - self.direction))
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
    seen = look(records, method, settle)
    scale_sigma = max((stops.scale_sigma for stops in seen.stops), default=0.0)
    posterior = estimate(seen.averages, horizontal, drift, scale_sigma)
    azimuth, sigma, candidates = summarise(posterior, near)
    angle_variance, of_turns = _angle_variance(posterior, seen, azimuth, horizontal)
    filters = {}
    if len(seen.stops) == 1 and method != "east":
        filters = classical(seen.stops[0], seen.direction, posterior.drift, tolerance_of(seen.stops))
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
        bound=azimuth_bound(seen.averages, posterior, azimuth, horizontal),
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


def _angle_variance(
    posterior: Posterior, seen: Seen, azimuth: float, horizontal: float
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
