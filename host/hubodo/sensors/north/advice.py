"""Recommendations for the next north measurement, from the noise of the last one."""

from __future__ import annotations

import math
from typing import Any

from hubodo.sensors.north.likelihood import UNIFORM_AZIMUTH_SIGMA
from hubodo.sensors.north.north_estimate import NorthEstimate
from hubodo.sensors.north.programme import (
    find_best_programme,
    find_shortest_programme,
    fit_ergodicity,
    white_noise_azimuth_bound,
)
from hubodo.unit_systems import angle_text

ADVICE_TURN_S = 2.0
MAX_AZIMUTH_SIGMA = math.radians(45)
"""Largest azimuth sigma that is reported; beyond it the small-angle prediction does not hold."""


def programme_json(estimate: NorthEstimate) -> dict[str, Any]:
    """Return the best programmes for the same time, for one minute, and for a sigma of one degree."""
    drift, horizontal = estimate.posterior.drift, estimate.horizontal_rate
    same = find_best_programme(drift, max(estimate.elapsed, 30.0), ADVICE_TURN_S, horizontal)
    minute = find_best_programme(drift, 60.0, ADVICE_TURN_S, horizontal)
    degree = find_shortest_programme(drift, math.radians(1.0), ADVICE_TURN_S, horizontal)
    return {
        "turn": ADVICE_TURN_S,
        **{
            name: None if programme is None or programme.sigma > MAX_AZIMUTH_SIGMA else programme.as_json()
            for name, programme in (("same_time", same), ("one_minute", minute), ("one_degree", degree))
        },
        "one_minute_white_noise_bound_deg": _bound_deg(white_noise_azimuth_bound(drift.n, 60.0, horizontal)),
    }


def _bound_deg(bound: float) -> float | None:
    """Return a bound in degrees, or None if it is no better than a guess."""
    return math.degrees(bound) if bound < UNIFORM_AZIMUTH_SIGMA else None


def _angle(degrees: float, spec: str) -> str:
    return angle_text(math.radians(degrees), spec)


def describe_programmes(estimate: NorthEstimate) -> list[str]:
    """Return the recommended programmes as lines of text, with the ergodicity of the estimates."""
    programmes = programme_json(estimate)
    lines = []
    if same := programmes["same_time"]:
        lines.append(
            f"recommended for the same time: {same['stops']} stops of {same['stop']:.0f} s at 0, 180, 90, "
            f"270 degrees, sigma {_angle(same['sigma_deg'], '.2f')}"
        )
    bound = programmes["one_minute_white_noise_bound_deg"]
    if minute := programmes["one_minute"]:
        lines.append(
            f"one minute gives a sigma of {_angle(minute['sigma_deg'], '.1f')}; "
            f"white noise alone gives {_angle(bound, '.1f')}"
        )
    else:
        lines.append(
            "one minute is too short to find north"
            + ("" if bound is None else f": white noise alone gives {_angle(bound, '.0f')}, without drift")
        )
    one_degree = programmes["one_degree"]
    lines.append(
        f"a sigma of {_angle(1.0, 'g')} takes {one_degree['time'] / 60:.0f} minutes: "
        f"{one_degree['stops']} stops of {one_degree['stop']:.0f} s"
        if one_degree
        else f"a sigma of {_angle(1.0, 'g')} cannot be reached within a day with this gyro"
    )
    ergodicity = fit_ergodicity(estimate.rates, neighbours_overlap=bool(estimate.stops))
    if ergodicity is not None:
        lines.append(
            f"the Allan deviation of the estimates falls with slope {ergodicity.slope:.2f} ± "
            f"{ergodicity.sigma:.2f}: "
            + (
                "they are independent (-1/2), so more stops or gyros help"
                if ergodicity.is_ergodic
                else "they are not independent"
            )
        )
    return lines
