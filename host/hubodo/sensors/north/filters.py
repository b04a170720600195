"""Classical maytagging filters: fixed weights on the means of the stops (Robert 2014).

The stops point along a direction (sign +1) or against it (-1), and each filter estimates the component of
Earth rate along that direction. The weights sum to 1/2 for sign +1 and to -1/2 for sign -1, so a constant
bias cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.drift import DriftNoise, drift_covariance
from hubodo.sensors.north.stops import Stops

Signs = NDArray[np.int64]

FILTER_LAGS = {"nearest": 1, "next_nearest": 3, "next_next_nearest": 5}
CLASSICAL_FILTERS = (*FILTER_LAGS, "swanson_schlamminger", "sliding_average")
"""nearest: half differences of each stop and its neighbours ("three vectors"). next_nearest,
next_next_nearest: of each stop and the two or three nearest opposite ones on each side ("five", "seven").
swanson_schlamminger: half the difference of the two overall means. sliding_average: nearest neighbours,
smoothed over SLIDING_WINDOW estimates."""
SLIDING_WINDOW = 5
DIRECTION_TOLERANCE = np.radians(2.0)
"""Largest deviation, rad, of a stop from a direction along which it counts."""


@dataclass(frozen=True)
class OppositePairs:
    """P pairs of opposite stops.

    first, second: (P,) index of the stop along the direction and of the one against it.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]

    def rates(self, means: Array) -> Array:
        """Return the (P,) half differences of the pairs, rad/s: the component along the direction."""
        return np.asarray((means[self.first] - means[self.second]) / 2)


@dataclass(frozen=True)
class ClassicalEstimate:
    """The estimate of one classical filter.

    Attributes:
        rate, sigma: components of Earth rate, rad/s, and their sigmas under the fitted drift: along table
            zero and a quarter turn from it if both were measured, otherwise along the stops.
        azimuth: rad, if both components were measured.
    """

    rate: tuple[float, ...]
    sigma: tuple[float, ...]
    azimuth: float | None


def find_opposite_pairs(sign: Signs, lag: int = 1) -> OppositePairs:
    """Return all pairs of opposite stops that are up to `lag` apart; sign: (S,) +1 or -1 in order of time."""
    first, second = [], []
    for i in range(len(sign)):
        for j in range(i + 1, min(i + lag, len(sign) - 1) + 1):
            if sign[i] != sign[j]:
                first.append(i if sign[i] > 0 else j)
                second.append(j if sign[i] > 0 else i)
    order = np.argsort(np.array(first) + np.array(second), kind="stable") if first else np.array([], np.int64)
    return OppositePairs(np.array(first, np.int64)[order], np.array(second, np.int64)[order])


def filter_weights(name: str, sign: Signs) -> Array:
    """Return the (S,) weights of the named filter; their product with the means of the stops is the rate.

    Raises InputError for an unknown filter or too few stops.
    """
    if name not in CLASSICAL_FILTERS:
        raise InputError(f"filter {name!r} is unknown; choose from {', '.join(CLASSICAL_FILTERS)}")
    count = len(sign)
    if not ((sign > 0).any() and (sign < 0).any()):
        raise InputError(
            f"{count} stops, all in the same direction; a filter needs stops in opposite directions"
        )
    if name == "swanson_schlamminger":
        up = sign > 0
        return np.where(up, 0.5 / np.count_nonzero(up), -0.5 / np.count_nonzero(~up))
    pairs = find_opposite_pairs(sign, FILTER_LAGS.get(name, 1))
    share = np.full(len(pairs.first), 1 / max(1, len(pairs.first)))
    if name == "sliding_average" and len(share) >= SLIDING_WINDOW:
        # The weights are averaged over all full windows; estimates near the ends occur in fewer of them.
        share = np.convolve(np.ones(len(share) - SLIDING_WINDOW + 1), np.ones(SLIDING_WINDOW))
        share = share / share.sum()
    weights = np.zeros(count)
    np.add.at(weights, pairs.first, share / 2)
    np.add.at(weights, pairs.second, -share / 2)
    return weights


def stop_signs(angle: Array, direction: float, tolerance: float = DIRECTION_TOLERANCE) -> NDArray[np.int64]:
    """Return (S,) +1 for stops along `direction` (rad), -1 for opposite stops, 0 for others."""
    cosine = np.cos(angle - direction)
    limit = np.cos(tolerance)
    return np.asarray(np.where(cosine > limit, 1, np.where(cosine < -limit, -1, 0)))


def apply_classical_filters(
    stops: Stops, direction: float, drift: DriftNoise, tolerance: float = DIRECTION_TOLERANCE
) -> dict[str, ClassicalEstimate]:
    """Apply each filter along `direction`, rad, and across it if stops point that way too."""
    weights = {}
    drift_covariance_matrix = drift_covariance(drift, stops.t[:, 0], stops.t[:, 1])
    for name in CLASSICAL_FILTERS:
        weight_vectors = []
        for quarter in (0.0, np.pi / 2):
            sign = stop_signs(stops.angle, direction + quarter, tolerance)
            used = np.flatnonzero(sign)
            if not ((sign > 0).any() and (sign < 0).any()):
                continue
            stop_weights = np.zeros(len(stops))
            stop_weights[used] = filter_weights(name, sign[used])
            weight_vectors.append(stop_weights)
        if len(weight_vectors) == 2:
            c, s = np.cos(direction), np.sin(direction)
            weight_vectors = [
                c * weight_vectors[0] - s * weight_vectors[1],
                s * weight_vectors[0] + c * weight_vectors[1],
            ]
        rate = tuple(float(w @ stops.mean) for w in weight_vectors)
        sigma = tuple(float(np.sqrt(w @ drift_covariance_matrix @ w)) for w in weight_vectors)
        azimuth = float(np.arctan2(rate[1], rate[0])) if len(rate) == 2 else None
        weights[name] = ClassicalEstimate(rate, sigma, azimuth)
    return weights
