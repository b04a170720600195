"""A north result as JSON of one gyro, and as advice for the next record."""

from __future__ import annotations

import math
from typing import Any

from hubodo.sensors.north.advice import best_programme, ergodicity, time_for, white_azimuth_bound
from hubodo.sensors.north.find import North
from hubodo.sensors.north.stops import Stops

TURN_S = 2.0
MEANINGLESS = math.radians(45)
"""A sigma beyond it is no azimuth, and the small-angle prediction that gave it does not hold."""


def gyro_json(node: str, axis: str, found: North) -> dict[str, Any]:
    """One gyro's result; angles in degrees, rates in rad/s, N, B, K in SI."""
    drift, ergodic = found.posterior.drift, ergodicity(found.rates, shared=bool(found.stops))
    components, spread = found.components()
    return {
        "node": node,
        "axis": axis,
        "method": found.method,
        "azimuth_deg": math.degrees(found.azimuth) % 360,
        "sigma_deg": math.degrees(found.sigma),
        "candidates_deg": [math.degrees(c) % 360 for c in found.candidates],
        "bound_deg": _finite(math.degrees(found.bound)),
        "white_noise_bound_deg": _finite(math.degrees(found.white_bound)),
        "rate": [float(r) for r in found.rates],
        "rate_across": [float(r) for r in found.cross],
        "rate_direction_deg": math.degrees(found.direction),
        "components": {"rate": components.tolist(), "sigma": spread.tolist()},
        "filters": {
            name: {
                "rate": list(f.rate),
                "sigma": list(f.sigma),
                "azimuth_deg": None if f.azimuth is None else math.degrees(f.azimuth) % 360,
            }
            for name, f in found.filters.items()
        },
        "drift": {"N": drift.n, "B": drift.b, "K": drift.k},
        "ergodicity": None
        if ergodic is None
        else {"slope": ergodic.slope, "sigma": ergodic.sigma, "ergodic": ergodic.ergodic},
        "angle_sigma_deg": math.degrees(found.angle_sigma),
        "stops": _stops_json(found.stops),
    }


def _stops_json(records: tuple[Stops, ...]) -> dict[str, Any] | None:
    """All stops of the records in order; angles as the table counts them, or as the gyro felt them."""
    if not records:
        return None
    return {
        "count": sum(map(len, records)),
        "cut": list(records[0].cut),
        "mean": [float(mean) for stops in records for mean in stops.mean],
        "t": [[float(a), float(b)] for stops in records for a, b in stops.t],
        "angle_deg": [math.degrees(angle) for stops in records for angle in stops.angle],
    }


def advice(found: North) -> dict[str, Any]:
    """What the next record should be, and what a minute can and cannot do."""
    drift, horizontal = found.posterior.drift, found.horizontal
    same = best_programme(drift, max(found.elapsed, 30.0), TURN_S, horizontal)
    minute = best_programme(drift, 60.0, TURN_S, horizontal)
    degree = time_for(drift, math.radians(1.0), TURN_S, horizontal)
    return {
        "turn": TURN_S,
        **{
            name: None
            if found_programme is None or found_programme.sigma > MEANINGLESS
            else {
                "stop": found_programme.stop,
                "stops": found_programme.count,
                "time": found_programme.time,
                "sigma_deg": math.degrees(found_programme.sigma),
            }
            for name, found_programme in (("same_time", same), ("one_minute", minute), ("one_degree", degree))
        },
        "one_minute_white_noise_bound_deg": math.degrees(white_azimuth_bound(drift.n, 60.0, horizontal)),
    }


def advice_words(found: North) -> list[str]:
    """The same in lines for people, with the verdict on ergodicity."""
    made = advice(found)
    lines = []
    if same := made["same_time"]:
        lines.append(
            f"recommended for the same time: {same['stops']} stops of {same['stop']:.0f} s at 0, 180, 90, "
            f"270 degrees, "
            f"sigma {same['sigma_deg']:.2f}°"
        )
    bound = made["one_minute_white_noise_bound_deg"]
    if minute := made["one_minute"]:
        lines.append(
            f"a minute is enough for {minute['sigma_deg']:.1f}°; white noise alone leaves {bound:.1f}°"
        )
    else:
        lines.append(
            f"a minute is not enough for any north: white noise alone leaves {bound:.0f}°, drift comes on top"
        )
    wanted = made["one_degree"]
    lines.append(
        f"1° takes {wanted['time'] / 60:.0f} minutes: {wanted['stops']} stops of {wanted['stop']:.0f} s"
        if wanted
        else "1° cannot be reached within a day with this gyro"
    )
    ergodic = ergodicity(found.rates, shared=bool(found.stops))
    if ergodic is not None:
        lines.append(
            f"Allan deviation of the estimates falls with slope {ergodic.slope:.2f} ± {ergodic.sigma:.2f}: "
            + (
                "independent of each other (-1/2), more stops or gyros help"
                if ergodic.ergodic
                else "not independent"
            )
        )
    return lines


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
