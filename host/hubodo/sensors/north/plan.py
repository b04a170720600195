"""Before anything is recorded: what a gyro's own noise allows, and which stops get there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.allan.characterise import characterise
from hubodo.sensors.heading.prior import noise_of_allan
from hubodo.sensors.north.advice import Advice, best_programme, time_for, white_azimuth_bound
from hubodo.sensors.north.drift import Drift

TIMES = (120.0, 300.0, 600.0, 1200.0, 2400.0, 3600.0, 7200.0)
"""s, for which the best stops are told."""


@dataclass(frozen=True)
class StopPlan:
    """Four-point programmes for one gyro.

    best: for each of TIMES where stops fit, with the white-noise bound of that time, rad. wanted: the
    shortest that reaches what was asked for, None where a day does not.
    """

    drift: Drift
    best: tuple[tuple[Advice, float], ...]
    wanted: Advice | None


def drift_of_allan(path: Path) -> Drift:
    """N, B, K as `hubodo allan --json` printed them. Raises InputError for another file, or without N."""
    noise = noise_of_allan(path)
    return Drift(noise.angle_random_walk, noise.bias_instability, noise.rate_random_walk)


def drift_at_rest(t: Array, values: Array, channel: str) -> Drift:
    """The same from a record at rest, (N,) s and (N,) rad/s. Raises InputError where it shows no N."""
    terms = characterise(t, values, channel).fit.terms
    n, b, k = (terms[name].value or 0.0 for name in "NBK")
    if n <= 0.0:
        raise InputError(f"{channel}: the record shows no angle random walk (N); record it longer or finer")
    return Drift(n, b, k)


def plan(drift: Drift, horizontal: float, sigma: float, turn: float) -> StopPlan:
    """sigma: rad wanted. turn: s from stop to stop, with what it takes to settle."""
    best = []
    for time in TIMES:
        found = best_programme(drift, time, turn, horizontal)
        if found is not None and found.sigma < np.pi / 4:
            best.append((found, white_azimuth_bound(drift.n, time, horizontal)))
    return StopPlan(drift, tuple(best), time_for(drift, sigma, turn, horizontal))
