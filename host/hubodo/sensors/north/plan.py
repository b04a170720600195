"""Planning of a north measurement: achievable sigma and best stops for the noise of a gyro."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.pages.console import print_lines, print_table
from hubodo.sensors.allan.characterise import characterise_noise
from hubodo.sensors.heading.prior import read_bias_noise
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.north_estimate import horizontal_earth_rate
from hubodo.sensors.north.programme import (
    StopProgramme,
    find_best_programme,
    find_shortest_programme,
    white_noise_azimuth_bound,
)
from hubodo.unit_systems import ANGLE, angle_text

if TYPE_CHECKING:
    from rich.console import Console

PLAN_TIMES_S = (120.0, 300.0, 600.0, 1200.0, 2400.0, 3600.0, 7200.0)
"""Durations, s, for which the best programme is listed."""


@dataclass(frozen=True)
class StopPlan:
    """Four-point programmes for one gyro.

    Attributes:
        latitude_deg: latitude, degrees.
        sigma_deg: requested sigma of the azimuth, degrees.
        turn: duration of a turn of the table, s.
        drift: noise of the gyro.
        programmes: for each of `PLAN_TIMES_S` the best programme and the white-noise bound of that time,
            rad.
        target_programme: shortest programme that reaches the requested sigma; None if a day is too short.
    """

    latitude_deg: float
    sigma_deg: float
    turn: float
    drift: DriftNoise
    programmes: tuple[tuple[StopProgramme, float], ...]
    target_programme: StopProgramme | None

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result: times in s, angles in degrees, N, B, K in SI units."""
        return {
            "latitude_deg": self.latitude_deg,
            "turn": self.turn,
            "drift": {"N": self.drift.n, "B": self.drift.b, "K": self.drift.k},
            "best": [
                {**programme.as_json(), "white_noise_bound_deg": math.degrees(bound)}
                for programme, bound in self.programmes
            ],
            "wanted_sigma_deg": self.sigma_deg,
            "wanted": None if self.target_programme is None else self.target_programme.as_json(),
        }

    def render(self, console: Console) -> None:
        """Print the plan for the requested sigma, then the best plan for each duration."""
        wanted = self.target_programme
        angle, target = ANGLE.shown(), angle_text(math.radians(self.sigma_deg), "g")
        line = (
            f"{target} cannot be reached within a day with this gyro"
            if wanted is None
            else f"{target} takes {wanted.time / 60:.0f} minutes: {wanted.count} stops of "
            f"{wanted.stop:g} s at 0, 180, 90, 270 degrees (sigma {angle_text(wanted.sigma, '.2f')})"
        )
        print_lines(console, [line])
        rows = [
            (
                f"{programme.time / 60:.0f}",
                str(programme.count),
                f"{programme.stop:g}",
                angle.number(programme.sigma, ".2f"),
                angle.number(bound, ".2f"),
            )
            for programme, bound in self.programmes
        ]
        sigmas = (f"{name}, {angle.name}" for name in ("sigma", "white noise alone"))
        print_table(console, ("minutes", "stops", "stop, s", *sigmas), rows)


def read_drift_noise(path: Path) -> DriftNoise:
    """Read N, B, K from the output of `hubodo allan --json`.

    Raises InputError if the file is another one or lacks N.
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


def plan_stops(drift: DriftNoise, latitude_deg: float, sigma_deg: float, turn: float) -> StopPlan:
    """Return the plan for a requested sigma; turn: time from stop to stop including settling, s.

    Raises InputError for an impossible latitude.
    """
    horizontal = horizontal_earth_rate(math.radians(latitude_deg))
    programmes = []
    for time in PLAN_TIMES_S:
        programme = find_best_programme(drift, time, turn, horizontal)
        if programme is not None and programme.sigma < np.pi / 4:
            programmes.append((programme, white_noise_azimuth_bound(drift.n, time, horizontal)))
    target = find_shortest_programme(drift, math.radians(sigma_deg), turn, horizontal)
    return StopPlan(latitude_deg, sigma_deg, turn, drift, tuple(programmes), target)
