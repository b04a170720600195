"""Azimuth of a turntable from Earth rate by maytagging, east seeking or carouseling (Robert 2014).

A level gyro axis at angle a from table zero, anticlockwise seen from above, reads Omega cos(latitude)
cos(azimuth - a) plus its bias, where azimuth is that of table zero, clockwise from north. For a node that
is upright with x along table zero, a of the x axis is the table angle and y is a quarter turn further,
upside down a quarter turn back.
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
from hubodo.sensors.north.circular import single_measured_direction, summarise_azimuth
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.earth_rate_test import EarthRateTest, check_earth_rate, describe_earth_rate
from hubodo.sensors.north.filters import ClassicalEstimate, apply_classical_filters
from hubodo.sensors.north.likelihood import (
    UNIFORM_AZIMUTH_SIGMA,
    EarthRatePosterior,
    azimuth_cramer_rao_bound,
    estimate_earth_rate,
)
from hubodo.sensors.north.measurements import Measurements, Method, collect_measurements, direction_tolerance
from hubodo.sensors.north.stops import Stops

MIN_HORIZONTAL_SHARE = 0.05
"""Smallest usable horizontal share of Earth rate, at 2.9 degrees from the pole.

Closer to the pole the effect of half a degree of tilt exceeds it.
"""


@dataclass(frozen=True)
class NorthEstimate:
    """The azimuth of table zero with its uncertainty and intermediate results.

    Attributes:
        method: "maytag", "maytag4", "carousel" or "east".
        azimuth, sigma: azimuth of table zero, clockwise from north, and its sigma, rad.
        earth_rate: test of the measured Earth rate against that of the latitude.
        angle_sigma: part of sigma due to errors of angles that the gyro itself measured, rad.
        candidates: azimuths that the records cannot distinguish (two if all stops are along one line),
            rad.
        other_azimuth: the candidate that is as probable as `azimuth`, or nearly, rad; None if there is none,
            or an approximate azimuth was given.
        direction: angle of the first stop, rad.
        rates: single estimates of Earth rate along `direction`, rad/s (east seeking: each along its own
            stop).
        rates_across: single estimates a quarter turn anticlockwise from `direction`, rad/s.
        duration, elapsed: time of measurement, and time including turns, s.
        horizontal_rate: Earth rate along the axis when it points north, rad/s.
        bound: Cramér-Rao bound of sigma for the gyro's noise and these stops, rad.
        white_bound: the same for white noise only, rad.
        posterior: posterior of Earth rate and azimuth.
        filters: estimates of the classical filters, for one record.
        stops: stops of each record.
        averages: averages of each record, the data of the likelihood.
        warnings: one line each.
        node, axis: name of the node and of its gyro axis.
    """

    method: Method
    azimuth: float
    sigma: float
    angle_sigma: float
    candidates: tuple[float, ...]
    direction: float
    rates: Array
    rates_across: Array
    duration: float
    elapsed: float
    horizontal_rate: float
    bound: float
    white_bound: float
    earth_rate: EarthRateTest
    posterior: EarthRatePosterior
    filters: Mapping[str, ClassicalEstimate]
    stops: tuple[Stops, ...]
    averages: tuple[Averages, ...]
    warnings: tuple[str, ...] = ()
    node: str = ""
    axis: str = ""
    other_azimuth: float | None = None

    @property
    def name(self) -> str:
        """Return node and axis as one name."""
        return f"{self.node} {self.axis}"

    def rate_components(self) -> tuple[Array, Array]:
        """Return rate and sigma of the likelihood, rad/s, in the components of the classical filters."""
        rate, covariance = self.posterior.rate, self.posterior.rate_covariance
        measured_direction = single_measured_direction(self.posterior)
        if measured_direction is not None:
            # Only one component was measured; the other one is unknown.
            line = np.array([[np.cos(measured_direction), np.sin(measured_direction)]]) * np.copysign(
                1.0, np.cos(measured_direction - self.direction)
            )
            return np.asarray(line @ rate), np.asarray(np.sqrt(np.diag(line @ covariance @ line.T)))
        return rate, np.asarray(np.sqrt(np.diag(covariance)))


def horizontal_earth_rate(latitude: float) -> float:
    """Return Omega cos(latitude), rad/s.

    Raise InputError for a latitude (rad) out of range or near a pole.
    """
    if not abs(latitude) <= np.pi / 2:
        raise InputError(
            f"latitude {np.degrees(latitude):.6g} degrees is out of range; give -90 to 90 degrees"
        )
    if np.cos(latitude) < MIN_HORIZONTAL_SHARE:
        raise InputError(
            f"latitude {np.degrees(latitude):.6g} degrees is too close to the pole: only "
            f"{100 * np.cos(latitude):.1f} % of Earth rate is horizontal there, less than the effect of "
            "tilt; find north by another method"
        )
    return EARTH_RATE * float(np.cos(latitude))


def find_north(
    records: Sequence[AxisRecord],
    latitude: float,
    method: Method,
    *,
    settle: float | None = None,
    near: float | None = None,
    drift: DriftNoise | None = None,
) -> NorthEstimate:
    """Estimate the azimuth of table zero from one or more records of an axis with a common table zero.

    latitude: rad. method: "maytag", "maytag4", "carousel" or "east". settle: time cut at both ends of each
    stop, s; None to estimate it. near: approximate azimuth of table zero, rad, which selects between the
    two candidates of stops along one line. drift: noise of the gyro if known; otherwise it is estimated.
    Raises InputError for too few stops, missing directions, an impossible latitude, or a table that moved
    during a stop.
    """
    level = float(np.mean([record.level_share for record in records]))
    horizontal = horizontal_earth_rate(latitude) * level
    measurements = collect_measurements(records, method, settle)
    scale_sigma = max((stops.scale_sigma for stops in measurements.stops), default=0.0)
    posterior = estimate_earth_rate(measurements.averages, horizontal, drift, scale_sigma)
    azimuth, sigma, candidates = summarise_azimuth(posterior, near)
    test = check_earth_rate(posterior, horizontal)
    if test.is_contradicted and (test.depends_on_latitude or not test.is_earth_rate):
        raise InputError(describe_earth_rate(test, latitude, level))
    angle_variance, turn_variance = _angle_variances(posterior, measurements, azimuth, horizontal)
    filters = {}
    if len(measurements.stops) == 1 and method != "east":
        filters = apply_classical_filters(
            measurements.stops[0],
            measurements.direction,
            posterior.drift,
            direction_tolerance(measurements.stops),
        )
    sigma = float(min(np.sqrt(sigma**2 + turn_variance + test.excess_sigma**2), UNIFORM_AZIMUTH_SIGMA))
    angle_sigma = float(np.sqrt(angle_variance + turn_variance))
    return NorthEstimate(
        method=method,
        azimuth=azimuth,
        sigma=sigma,
        angle_sigma=angle_sigma,
        candidates=candidates,
        direction=measurements.direction,
        rates=measurements.rates,
        rates_across=measurements.rates_across,
        duration=measurements.duration,
        elapsed=measurements.elapsed,
        horizontal_rate=horizontal,
        bound=_finite_bound(azimuth_cramer_rao_bound(measurements.averages, posterior, azimuth, horizontal)),
        white_bound=_finite_bound(
            _white_bound(measurements.averages, posterior.drift.n, azimuth, horizontal)
        ),
        earth_rate=test,
        posterior=posterior,
        filters=filters,
        stops=measurements.stops,
        averages=measurements.averages,
        other_azimuth=None if near is not None else _find_other_candidate(azimuth, candidates),
        warnings=(
            *measurements.notes,
            *(note for stops in measurements.stops for note in stops.notes),
            *([describe_earth_rate(test, latitude, level)] if test.is_contradicted else []),
            *_describe_ambiguity(posterior, candidates, azimuth, sigma, near),
            *_describe_excess_noise(drift, posterior),
            *_describe_angle_sigma(angle_sigma, sigma),
        ),
    )


def _find_other_candidate(azimuth: float, candidates: tuple[float, ...]) -> float | None:
    """Return the candidate that is not the answer; None if the answer is the only one or between both."""
    others = [candidate for candidate in candidates if candidate != azimuth]
    return others[0] if len(others) == 1 and len(candidates) == 2 else None


def _describe_ambiguity(
    posterior: EarthRatePosterior,
    candidates: tuple[float, ...],
    azimuth: float,
    sigma: float,
    near: float | None,
) -> tuple[str, ...]:
    """Return a line if two azimuths are possible, and a line if sigma is too large for a useful azimuth."""
    warnings = []
    azimuths = " and ".join(f"{np.degrees(c) % 360:.2f}" for c in candidates)
    if single_measured_direction(posterior) is not None:
        choice = (
            "add stops in a perpendicular direction, or give an approximate azimuth with --near-deg"
            if near is None
            else "the one closer to the given azimuth was selected"
        )
        text = f"stops along one line allow two azimuths: {azimuths} degrees; {choice}"
        if near is None and azimuth not in candidates:
            text = (
                f"stops along one line allow two azimuths, one on either side of "
                f"{np.degrees(azimuth) % 360:.2f} degrees, where the probability is highest; each side alone "
                f"gives {azimuths} degrees; {choice}"
            )
        warnings.append(text)
    elif len(candidates) > 1:
        warnings.append(
            f"the record allows two azimuths, the more probable one first: {azimuths} degrees; record more "
            "stops, or give an approximate azimuth with --near-deg"
        )
    if sigma > np.radians(45):
        warnings.append("this record does not determine north: the uncertainty is as large as the answer")
    return tuple(warnings)


def _describe_angle_sigma(angle_sigma: float, sigma: float) -> tuple[str, ...]:
    if angle_sigma < 0.7 * sigma:
        return ()
    return (
        f"{np.degrees(angle_sigma):.1f} degrees of sigma are due to angles measured by the gyro itself; "
        "provide table.csv, give the step of the table with --step-deg, or turn the table back in the "
        "opposite sense",
    )


def _describe_excess_noise(given: DriftNoise | None, posterior: EarthRatePosterior) -> tuple[str, ...]:
    if given is None or posterior.drift.n == given.n:
        return ()
    noise_ratio = posterior.drift.n / given.n
    return (
        f"the record is {noise_ratio:.1f} times as noisy as given by --allan; sigma is scaled accordingly",
    )


def _angle_variances(
    posterior: EarthRatePosterior, measurements: Measurements, azimuth: float, horizontal: float
) -> tuple[float, float]:
    """Return the azimuth variances, rad², due to the gyro's scale error and to turn angle noise."""
    across = np.array([-np.sin(azimuth), np.cos(azimuth)])
    scale_variance = float(across @ posterior.angle_covariance @ across) / horizontal**2
    turn_variance = 0.0
    for stops in measurements.stops:
        # The weight of a stop is its component towards east or west; its angle error is the sum over
        # earlier turns.
        weight = np.sin(azimuth - stops.angle) ** 2 * (stops.t[:, 1] - stops.t[:, 0])
        weight = weight / max(float(weight.sum()), 1e-300)
        later_weight = np.cumsum(weight[::-1])[::-1][1:]
        turn_variance += stops.turn_sigma**2 * float((later_weight**2).sum())
    return scale_variance, float(turn_variance)


def _white_bound(records: Sequence[Averages], n: float, azimuth: float, horizontal: float) -> float:
    """Return the azimuth sigma, rad, for white noise only and a known norm of Earth rate.

    With evenly distributed directions it is sqrt(2/T) N / horizontal, because half of the information of a
    level axis is across the azimuth.
    """
    information = 0.0
    for averages in records:
        across = horizontal * (-np.sin(azimuth) * averages.cos + np.cos(azimuth) * averages.sin)
        duration = averages.end - averages.start
        across = across - np.average(across, weights=duration)
        information += float((across**2 * duration).sum()) / n**2 if n > 0 else np.inf
    return float(1 / np.sqrt(information)) if information > 0 else float("inf")


def _finite_bound(bound: float) -> float:
    """Return an azimuth bound, rad; infinity if it is no better than a guess.

    For stops along the north-south line the cosine is flat, so the information is zero up to rounding.
    """
    return bound if bound < UNIFORM_AZIMUTH_SIGMA else float("inf")
