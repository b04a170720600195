"""The classical filters of maytagging: each a fixed set of weights on the means of the stops (Robert 2014).

All take stops that point along a direction (sign +1) or against it (-1) and give the component of Earth rate
along that direction: the weights of the first kind add up to 1/2, of the second to -1/2, so a constant bias
drops out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.drift import Drift, covariance
from hubodo.sensors.north.stops import Stops

Signs = NDArray[np.int64]

LAGS = {"nearest": 1, "next_nearest": 3, "next_next_nearest": 5}
FILTERS = (*LAGS, "swanson_schlamminger", "sliding_average")
"""nearest: each stop against those before and after it ("three vectors"). next_nearest, next_next_nearest:
against the two and three nearest opposite ones on each side ("five", "seven"). swanson_schlamminger: half
the difference of both means. sliding_average: nearest neighbours smoothed over SLIDING estimates before they
are averaged."""
SLIDING = 5
TOLERANCE = np.radians(2.0)
"""By which stops may miss a direction and still count as along it."""


@dataclass(frozen=True)
class Pairs:
    """Half differences of opposite stops.

    first, second: (P,) number of the stop along and of the one against.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]

    def rates(self, means: Array) -> Array:
        """(P,) rad/s, component along the direction."""
        return np.asarray((means[self.first] - means[self.second]) / 2)


@dataclass(frozen=True)
class Classical:
    """One classical filter: rate rad/s and its sigma under the fitted drift.

    Two components, along table zero and a quarter turn from it, and the azimuth (rad) where both were
    measured; else the one along the stops.
    """

    rate: tuple[float, ...]
    sigma: tuple[float, ...]
    azimuth: float | None


def opposite_pairs(sign: Signs, lag: int = 1) -> Pairs:
    """All pairs of opposite stops that are 1, 3, .. `lag` apart. sign: (S,) +1 or -1 in order of time."""
    along, against = [], []
    for i in range(len(sign)):
        for j in range(i + 1, min(i + lag, len(sign) - 1) + 1):
            if sign[i] != sign[j]:
                along.append(i if sign[i] > 0 else j)
                against.append(j if sign[i] > 0 else i)
    order = (
        np.argsort(np.array(along) + np.array(against), kind="stable") if along else np.array([], np.int64)
    )
    return Pairs(np.array(along, np.int64)[order], np.array(against, np.int64)[order])


def weights(name: str, sign: Signs) -> Array:
    """(S,) weights of the named filter, whose product with the means of the stops is the rate.

    Raises InputError for an unknown filter or too few stops.
    """
    if name not in FILTERS:
        raise InputError(f"filter {name!r} is unknown; choose from {', '.join(FILTERS)}")
    count = len(sign)
    if not ((sign > 0).any() and (sign < 0).any()):
        raise InputError(
            f"{count} stops, all facing the same way; a filter needs stops that face opposite ways"
        )
    if name == "swanson_schlamminger":
        up = sign > 0
        return np.where(up, 0.5 / np.count_nonzero(up), -0.5 / np.count_nonzero(~up))
    pairs = opposite_pairs(sign, LAGS.get(name, 1))
    share = np.full(len(pairs.first), 1 / max(1, len(pairs.first)))
    if name == "sliding_average" and len(share) >= SLIDING:
        # The mean of all full windows: estimates near the ends stand in fewer of them.
        share = np.convolve(np.ones(len(share) - SLIDING + 1), np.ones(SLIDING))
        share = share / share.sum()
    made = np.zeros(count)
    np.add.at(made, pairs.first, share / 2)
    np.add.at(made, pairs.second, -share / 2)
    return made


def along(angle: Array, direction: float, tolerance: float = TOLERANCE) -> NDArray[np.int64]:
    """(S,) +1 for stops at `direction`, -1 for stops opposite, 0 for others; rad."""
    off = np.cos(angle - direction)
    limit = np.cos(tolerance)
    return np.asarray(np.where(off > limit, 1, np.where(off < -limit, -1, 0)))


def classical(
    stops: Stops, direction: float, drift: Drift, tolerance: float = TOLERANCE
) -> dict[str, Classical]:
    """Each filter along `direction`, rad, and across it where stops point that way too."""
    made = {}
    spread = covariance(drift, stops.t[:, 0], stops.t[:, 1])
    for name in FILTERS:
        vectors = []
        for quarter in (0.0, np.pi / 2):
            sign = along(stops.angle, direction + quarter, tolerance)
            chosen = np.flatnonzero(sign)
            if not ((sign > 0).any() and (sign < 0).any()):
                continue
            full = np.zeros(len(stops))
            full[chosen] = weights(name, sign[chosen])
            vectors.append(full)
        if len(vectors) == 2:
            c, s = np.cos(direction), np.sin(direction)
            vectors = [c * vectors[0] - s * vectors[1], s * vectors[0] + c * vectors[1]]
        rate = tuple(float(w @ stops.mean) for w in vectors)
        sigma = tuple(float(np.sqrt(w @ spread @ w)) for w in vectors)
        azimuth = float(np.arctan2(rate[1], rate[0])) if len(rate) == 2 else None
        made[name] = Classical(rate, sigma, azimuth)
    return made
