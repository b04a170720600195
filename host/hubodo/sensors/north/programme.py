"""Maytagging programmes: ergodicity of rate estimates, best stop length, number of stops, duration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.allan.deviation import allan_deviation
from hubodo.sensors.north.drift import DriftNoise, drift_covariance

STOP_LENGTHS_S = (2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 16.0, 20.0, 24.0, 34.0, 48.0, 68.0, 100.0, 150.0, 240.0)
MAX_PROGRAMME_STOPS = 80
"""Number of stops beyond which drift is uncorrelated; a longer programme repeats one of this length."""
MIN_PROGRAMME_STOPS = 5
"""Four unknowns (two components, bias and ramp) plus one degree of freedom."""
MIN_ERGODICITY_ESTIMATES = 16
OVERLAP_SIGMA_FACTOR = 1.4
"""Standard deviation of the log-log slope for white noise, relative to that for independent octaves.

Neighbouring octaves share data; estimated from 300 seeds with 100 to 1,800 estimates each.
"""


@dataclass(frozen=True)
class Ergodicity:
    """The Allan deviation of the rate estimates and its slope.

    Independent estimates have the slope -1/2 (Robert 2014, fig. 12): the sigma then decreases as the
    square root of the number of stops or gyros.

    Attributes:
        factors: (P,) numbers of estimates averaged.
        adev: (P,) Allan deviation, rad/s.
        slope, sigma: log-log slope and its sigma.
    """

    factors: Array
    adev: Array
    slope: float
    sigma: float

    @property
    def is_ergodic(self) -> bool:
        """Return True if the slope is within two sigma of -1/2."""
        return abs(self.slope + 0.5) < 2 * self.sigma


@dataclass(frozen=True)
class StopProgramme:
    """A four-point programme.

    Attributes:
        stop: duration of a stop, s.
        count: number of stops.
        time: total duration including turns, s.
        sigma: azimuth sigma, rad.
    """

    stop: float
    count: int
    time: float
    sigma: float

    def as_json(self) -> dict[str, float]:
        """Return the programme as in `hubodo north --json`: times in s, sigma in degrees."""
        return {
            "stop": self.stop,
            "stops": self.count,
            "time": self.time,
            "sigma_deg": math.degrees(self.sigma),
        }


def fit_ergodicity(rates: Array, *, neighbours_overlap: bool = True) -> Ergodicity | None:
    """Fit the slope of the Allan deviation of rate estimates, or return None for fewer than 16 estimates.

    neighbours_overlap: consecutive estimates share a stop, as half differences of neighbouring stops do.
    The Allan variance of averages of m estimates is then (m - 3/4) / m of that for independent ones, which
    is corrected before the slope is fitted.
    """
    if len(rates) < MIN_ERGODICITY_ESTIMATES or not np.ptp(rates):
        return None
    points = allan_deviation(rates, 1.0)
    n, m = len(rates), points.factors.astype(np.float64)
    used = (m <= len(rates) / 4) & (points.adev > 0)
    # Drift from stop to stop decreases as 1/m, so only long averages show the asymptotic slope.
    long_averages = used & (m >= max(4.0, np.sqrt(n) / 4))
    used = long_averages if np.count_nonzero(long_averages) >= 3 else used
    m = m[used]
    adev = points.adev[used] / np.sqrt(1 - 0.75 / m if neighbours_overlap else 1.0)
    # Degrees of freedom of the overlapping Allan variance of white noise (NIST SP 1065, table 5).
    dof = np.maximum((3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5), 1.0)
    x, weight = np.log(m), 2 * dof
    centre = np.average(x, weights=weight)
    weighted_spread = float((weight * (x - centre) ** 2).sum())
    slope = float((weight * (x - centre) * np.log(adev)).sum()) / weighted_spread
    return Ergodicity(m, adev, slope, OVERLAP_SIGMA_FACTOR / float(np.sqrt(weighted_spread)))


def programme_sigma(drift: DriftNoise, stop: float, count: int, turn: float, horizontal: float) -> float:
    """Return the azimuth sigma, rad, of `count` stops of `stop` s at 0, 180, 90, 270 degrees.

    turn: time between stops, s. horizontal: Earth rate along the axis when it points north, rad/s. Bias
    and ramp are unknown. The sigma is averaged over all azimuths: sqrt(tr(information^-1) / 2) /
    horizontal.
    """
    stop_count = min(count, MAX_PROGRAMME_STOPS)
    return _component_sigma(drift, stop, stop_count, turn) * float(np.sqrt(stop_count / count)) / horizontal


@lru_cache(maxsize=4096)
def _component_sigma(drift: DriftNoise, stop: float, stop_count: int, turn: float) -> float:
    """Return the root of half the trace of the covariance of both components, rad/s."""
    start = np.arange(stop_count, dtype=np.float64) * (stop + turn)
    angle = np.resize(np.array([0.0, np.pi, np.pi / 2, 3 * np.pi / 2]), stop_count)
    inverse = np.linalg.inv(drift_covariance(drift, start, start + stop))
    ramp = np.linspace(-1.0, 1.0, stop_count)
    columns = np.column_stack([np.ones(stop_count), ramp, np.cos(angle), np.sin(angle)])
    weighted_spread = np.linalg.inv(columns.T @ inverse @ columns)[2:, 2:]
    return float(np.sqrt(np.trace(weighted_spread) / 2))


def find_best_programme(
    drift: DriftNoise, time: float, turn: float, horizontal: float
) -> StopProgramme | None:
    """Return the programme with the smallest azimuth sigma within `time` s, or None if too few stops fit."""
    programmes = []
    for stop in STOP_LENGTHS_S:
        count = int((time + turn) // (stop + turn))
        if count >= MIN_PROGRAMME_STOPS:
            sigma = programme_sigma(drift, stop, count, turn, horizontal)
            programmes.append(StopProgramme(stop, count, count * (stop + turn) - turn, sigma))
    return min(programmes, key=lambda programme: programme.sigma) if programmes else None


def find_shortest_programme(
    drift: DriftNoise, sigma: float, turn: float, horizontal: float, limit: float = 86400.0
) -> StopProgramme | None:
    """Return the shortest programme with at most `sigma` (rad), or None up to `limit` s.

    Durations are tried in steps of half an octave from 30 s on.
    """
    time = 30.0
    while time <= limit:
        programme = find_best_programme(drift, time, turn, horizontal)
        if programme is not None and programme.sigma <= sigma:
            return programme
        time *= 2**0.5
    return None


def white_noise_azimuth_bound(n: float, time: float, horizontal: float) -> float:
    """Return the azimuth sigma, rad, of one axis with evenly distributed directions for white noise only.

    It is sqrt(2 / T) N / horizontal, with T the duration.
    """
    return float(np.sqrt(2 / time)) * n / horizontal
