"""JSON form of the north estimate of one gyro, and recommendations for the next record."""

from __future__ import annotations

import math
from typing import Any

from hubodo.sensors.north.north_estimate import NorthEstimate
from hubodo.sensors.north.programme import (
    find_best_programme,
    find_shortest_programme,
    fit_ergodicity,
    white_noise_azimuth_bound,
)
from hubodo.sensors.north.stops import Stops

ADVICE_TURN_S = 2.0
MAX_AZIMUTH_SIGMA = math.radians(45)
"""Largest azimuth sigma that is reported; beyond it the small-angle prediction does not hold."""


def gyro_json(node: str, axis: str, estimate: NorthEstimate) -> dict[str, Any]:
    """Return the JSON form of one gyro's result; angles in degrees, rates in rad/s, N, B, K in SI."""
    drift, ergodicity = (
        estimate.posterior.drift,
        fit_ergodicity(estimate.rates, neighbours_overlap=bool(estimate.stops)),
    )
    components, sigmas = estimate.rate_components()
    return {
        "node": node,
        "axis": axis,
        "method": estimate.method,
        "azimuth_deg": math.degrees(estimate.azimuth) % 360,
        "sigma_deg": math.degrees(estimate.sigma),
        "candidates_deg": [math.degrees(c) % 360 for c in estimate.candidates],
        "bound_deg": _finite(math.degrees(estimate.bound)),
        "white_noise_bound_deg": _finite(math.degrees(estimate.white_bound)),
        "rate": [float(r) for r in estimate.rates],
        "rate_across": [float(r) for r in estimate.rates_across],
        "rate_direction_deg": math.degrees(estimate.direction),
        "components": {"rate": components.tolist(), "sigma": sigmas.tolist()},
        "filters": {
            name: {
                "rate": list(f.rate),
                "sigma": list(f.sigma),
                "azimuth_deg": None if f.azimuth is None else math.degrees(f.azimuth) % 360,
            }
            for name, f in estimate.filters.items()
        },
        "drift": {"N": drift.n, "B": drift.b, "K": drift.k},
        "ergodicity": None
        if ergodicity is None
        else {"slope": ergodicity.slope, "sigma": ergodicity.sigma, "ergodic": ergodicity.is_ergodic},
        "angle_sigma_deg": math.degrees(estimate.angle_sigma),
        "stops": _stops_json(estimate.stops),
    }


def _stops_json(records: tuple[Stops, ...]) -> dict[str, Any] | None:
    """Return all stops of the records in order, with angles from the table or from the gyro."""
    if not records:
        return None
    return {
        "count": sum(map(len, records)),
        "cut": list(records[0].cut),
        "mean": [float(mean) for stops in records for mean in stops.mean],
        "t": [[float(a), float(b)] for stops in records for a, b in stops.t],
        "angle_deg": [math.degrees(angle) for stops in records for angle in stops.angle],
    }


def programme_json(estimate: NorthEstimate) -> dict[str, Any]:
    """Return the best programmes for the same time, for one minute, and for a sigma of one degree."""
    drift, horizontal = estimate.posterior.drift, estimate.horizontal_rate
    same = find_best_programme(drift, max(estimate.elapsed, 30.0), ADVICE_TURN_S, horizontal)
    minute = find_best_programme(drift, 60.0, ADVICE_TURN_S, horizontal)
    degree = find_shortest_programme(drift, math.radians(1.0), ADVICE_TURN_S, horizontal)
    return {
        "turn": ADVICE_TURN_S,
        **{
            name: None
            if programme is None or programme.sigma > MAX_AZIMUTH_SIGMA
            else {
                "stop": programme.stop,
                "stops": programme.count,
                "time": programme.time,
                "sigma_deg": math.degrees(programme.sigma),
            }
            for name, programme in (("same_time", same), ("one_minute", minute), ("one_degree", degree))
        },
        "one_minute_white_noise_bound_deg": math.degrees(
            white_noise_azimuth_bound(drift.n, 60.0, horizontal)
        ),
    }


def describe_programmes(estimate: NorthEstimate) -> list[str]:
    """Return the recommended programmes as lines of text, with the ergodicity of the estimates."""
    programmes = programme_json(estimate)
    lines = []
    if same := programmes["same_time"]:
        lines.append(
            f"recommended for the same time: {same['stops']} stops of {same['stop']:.0f} s at 0, 180, 90, "
            f"270 degrees, sigma {same['sigma_deg']:.2f}°"
        )
    bound = programmes["one_minute_white_noise_bound_deg"]
    if minute := programmes["one_minute"]:
        lines.append(
            f"one minute gives a sigma of {minute['sigma_deg']:.1f}°; white noise alone gives {bound:.1f}°"
        )
    else:
        lines.append(
            f"one minute is too short to find north: white noise alone gives {bound:.0f}°, without drift"
        )
    one_degree = programmes["one_degree"]
    lines.append(
        f"a sigma of 1° takes {one_degree['time'] / 60:.0f} minutes: {one_degree['stops']} stops of "
        f"{one_degree['stop']:.0f} s"
        if one_degree
        else "a sigma of 1° cannot be reached within a day with this gyro"
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


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
