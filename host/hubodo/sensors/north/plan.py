"""Planning of a north measurement: achievable sigma and best stops for the noise of a gyro."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.allan.characterise import characterise_noise
from hubodo.sensors.heading.prior import read_bias_noise
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.programme import (
    StopProgramme,
    find_best_programme,
    find_shortest_programme,
    white_noise_azimuth_bound,
)

PLAN_TIMES_S = (120.0, 300.0, 600.0, 1200.0, 2400.0, 3600.0, 7200.0)
"""Durations, s, for which the best programme is listed."""


@dataclass(frozen=True)
class StopPlan:
    """Four-point programmes for one gyro.

    Attributes:
        drift: noise of the gyro.
        programmes: for each of `PLAN_TIMES_S` the best programme and the white-noise bound of that time,
            rad.
        target_programme: shortest programme that reaches the requested sigma; None if a day is too short.
    """

    drift: DriftNoise
    programmes: tuple[tuple[StopProgramme, float], ...]
    target_programme: StopProgramme | None


def read_drift_noise(path: Path) -> DriftNoise:
    """Read N, B, K from the output of `hubodo allan --json`.

    Raise InputError for another file or without N.
    """
    noise = read_bias_noise(path)
    return DriftNoise(noise.angle_random_walk, noise.bias_instability, noise.rate_random_walk)


def drift_noise_from_standstill(t: Array, values: Array, channel: str) -> DriftNoise:
    """Estimate N, B, K from a stationary record, t (N,) s, values (N,) rad/s; raise InputError without N."""
    terms = characterise_noise(t, values, channel).fit.terms
    n, b, k = (terms[name].value or 0.0 for name in "NBK")
    if n <= 0.0:
        raise InputError(f"{channel}: the record shows no angle random walk (N); record it longer or finer")
    return DriftNoise(n, b, k)


def plan_stops(drift: DriftNoise, horizontal: float, sigma: float, turn: float) -> StopPlan:
    """Return the plan for a requested sigma, rad; turn: time from stop to stop including settling, s."""
    programmes = []
    for time in PLAN_TIMES_S:
        programme = find_best_programme(drift, time, turn, horizontal)
        if programme is not None and programme.sigma < np.pi / 4:
            programmes.append((programme, white_noise_azimuth_bound(drift.n, time, horizontal)))
    return StopPlan(drift, tuple(programmes), find_shortest_programme(drift, sigma, turn, horizontal))
