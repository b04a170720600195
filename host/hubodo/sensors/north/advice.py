"""What rate estimates say of the next record: ergodicity, stop length, number of stops, time needed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.allan.deviation import allan_deviation
from hubodo.sensors.north.drift import Drift, covariance

STOP_LENGTHS = (2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 16.0, 20.0, 24.0, 34.0, 48.0, 68.0, 100.0, 150.0, 240.0)
MAX_STOPS = 80
"""Longer programmes are taken as repetitions of this many stops: drift does not reach across more."""
FEWEST = 5
"""Four unknowns, two components with bias and ramp, and one stop to see that they fit."""
MIN_ESTIMATES = 16
OCTAVES_OVERLAP = 1.4
"""By how much more the slope of white noise scatters than independent points would let it.

Neighbouring octaves are made of the same data (300 seeds, 100 to 1,800 estimates).
"""


@dataclass(frozen=True)
class Ergodicity:
    """Allan deviation of the rate estimates.

    factors (P,) estimates averaged, adev (P,) rad/s, slope in log-log. Estimates that are independent of each
    other have slope -1/2 (Robert 2014, fig. 12): then more stops, or more gyros, help as the square root of
    their number.
    """

    factors: Array
    adev: Array
    slope: float
    sigma: float

    @property
    def ergodic(self) -> bool:
        """Whether -1/2 lies within two sigma of the slope."""
        return abs(self.slope + 0.5) < 2 * self.sigma


@dataclass(frozen=True)
class Advice:
    """A four-point programme: stop length s, number of stops, time s with turns, azimuth sigma rad."""

    stop: float
    count: int
    time: float
    sigma: float


def ergodicity(rates: Array, *, shared: bool = True) -> Ergodicity | None:
    """None with fewer than 16 estimates: too short a line to have a slope.

    shared: each estimate has a stop in common with the next, as half differences of neighbours have. The
    mean of m of them then has (m - 3/4) / m instead of the Allan variance of independent ones, which is
    taken out before the slope is fitted.
    """
    if len(rates) < MIN_ESTIMATES or not np.ptp(rates):
        return None
    points = allan_deviation(rates, 1.0)
    n, m = len(rates), points.factors.astype(np.float64)
    keep = (m <= len(rates) / 4) & (points.adev > 0)
    # Drift that changes from stop to stop falls as 1/m and is soon gone: long averages show what remains.
    late = keep & (m >= max(4.0, np.sqrt(n) / 4))
    keep = late if np.count_nonzero(late) >= 3 else keep
    m = m[keep]
    adev = points.adev[keep] / np.sqrt(1 - 0.75 / m if shared else 1.0)
    # Degrees of freedom of the overlapping Allan variance of white noise (NIST SP 1065, table 5).
    freedom = np.maximum((3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5), 1.0)
    x, weight = np.log(m), 2 * freedom
    centre = np.average(x, weights=weight)
    spread = float((weight * (x - centre) ** 2).sum())
    slope = float((weight * (x - centre) * np.log(adev)).sum()) / spread
    return Ergodicity(m, adev, slope, OCTAVES_OVERLAP / float(np.sqrt(spread)))


def programme_sigma(drift: Drift, stop: float, count: int, turn: float, horizontal: float) -> float:
    """Azimuth sigma, rad, of `count` stops of `stop` s at 0, 180, 90, 270 degrees with the best weights.

    turn: s between stops. Bias and ramp are unknown. Mean over all azimuths: sqrt(tr(information^-1) / 2) /
    horizontal.
    """
    whole = min(count, MAX_STOPS)
    return _unit_sigma(drift, stop, whole, turn) * float(np.sqrt(whole / count)) / horizontal


@lru_cache(maxsize=4096)
def _unit_sigma(drift: Drift, stop: float, whole: int, turn: float) -> float:
    """rad/s, root of half the trace of the covariance of both components."""
    start = np.arange(whole, dtype=np.float64) * (stop + turn)
    angle = np.resize(np.array([0.0, np.pi, np.pi / 2, 3 * np.pi / 2]), whole)
    inverse = np.linalg.inv(covariance(drift, start, start + stop))
    ramp = np.linspace(-1.0, 1.0, whole)
    columns = np.column_stack([np.ones(whole), ramp, np.cos(angle), np.sin(angle)])
    spread = np.linalg.inv(columns.T @ inverse @ columns)[2:, 2:]
    return float(np.sqrt(np.trace(spread) / 2))


def best_programme(drift: Drift, time: float, turn: float, horizontal: float) -> Advice | None:
    """The stop length that gives the smallest azimuth sigma within `time` s.

    None when not even FEWEST stops fit.
    """
    found = []
    for stop in STOP_LENGTHS:
        count = int((time + turn) // (stop + turn))
        if count >= FEWEST:
            sigma = programme_sigma(drift, stop, count, turn, horizontal)
            found.append(Advice(stop, count, count * (stop + turn) - turn, sigma))
    return min(found, key=lambda advice: advice.sigma) if found else None


def time_for(
    drift: Drift, sigma: float, turn: float, horizontal: float, limit: float = 86400.0
) -> Advice | None:
    """The shortest programme that reaches `sigma` rad, or None.

    Tried in steps of half an octave from half a minute on.
    """
    time = 30.0
    while time <= limit:
        advice = best_programme(drift, time, turn, horizontal)
        if advice is not None and advice.sigma <= sigma:
            return advice
        time *= 2**0.5
    return None


def white_azimuth_bound(n: float, time: float, horizontal: float) -> float:
    """rad; what white noise alone leaves of one axis that looks all ways evenly.

    sqrt(2 / T) N / horizontal.
    """
    return float(np.sqrt(2 / time)) * n / horizontal
