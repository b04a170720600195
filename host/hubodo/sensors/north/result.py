"""The result of `hubodo north`: as JSON, and as text and tables on a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hubodo.html_table import html_lines, html_table
from hubodo.pages.console import print_lines, print_table
from hubodo.sensors.north.advice import describe_programmes, programme_json
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.east import EastSeekResult
from hubodo.sensors.north.north_estimate import NorthEstimate
from hubodo.sensors.north.page import (
    describe_white_bound,
    estimate_rows,
    explain_sigma_below_bound,
    noise_rows,
    rate_headings,
)
from hubodo.sensors.north.programme import fit_ergodicity
from hubodo.sensors.north.stops import Stops
from hubodo.unit_systems import RATE, angle_text

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class NorthResult:
    """The azimuth of table zero from one axis, or from several axes combined.

    Attributes
    ----------
    latitude_deg : float
        Latitude, degrees.
    azimuth, sigma : float
        Azimuth of table zero clockwise from north and its sigma, rad.
    gyros : tuple of NorthEstimate
        North estimate of each gyro axis.
    warnings : tuple of str
        One line each.
    calibration : mapping
        Calibration that was applied, by node.
    simulated_azimuth : float or None
        True azimuth of a simulated table, rad.
    output : str or None
        Path of the log of a live run.
    east, east_table_angle : EastSeekResult and float, or None
        Steps of the east-seeking loop, and its final table angle, rad.
    """

    latitude_deg: float
    azimuth: float
    sigma: float
    gyros: tuple[NorthEstimate, ...]
    warnings: tuple[str, ...]
    calibration: Mapping[str, Mapping[str, Any]]
    simulated_azimuth: float | None = None
    output: str | None = None
    east: EastSeekResult | None = None
    east_table_angle: float | None = None

    @property
    def other_azimuth(self) -> float | None:
        """Second azimuth that the records allow, rad; None if there is none. Several axes decide together."""
        return self.gyros[0].other_azimuth if len(self.gyros) == 1 else None

    def describe_azimuth(self, decimals: int) -> str:
        """Return the azimuth and its sigma, or both azimuths if the records allow two.

        Parameters
        ----------
        decimals : int
            Number of decimals of degrees.

        Returns
        -------
        str
            Words for a sentence about table zero.
        """
        sigma = f"± {angle_text(self.sigma, f'.{decimals}f')}"
        first = angle_text(self.azimuth % math.tau, f".{decimals}f")
        if self.other_azimuth is None:
            return f"{first} {sigma}"
        other = angle_text(self.other_azimuth % math.tau, f".{decimals}f")
        return f"either {first} or {other}, each {sigma}"

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result of `hubodo north`.

        Returns
        -------
        dict
            The JSON object: angles in degrees, rates in rad/s, times in s.
        """
        first = self.gyros[0]
        summary: dict[str, Any] = {
            "azimuth_deg": math.degrees(self.azimuth) % 360,
            "sigma_deg": math.degrees(self.sigma),
            "other_azimuth_deg": None
            if self.other_azimuth is None
            else math.degrees(self.other_azimuth) % 360,
            "rate": [float(r) for r in first.rates],
            "duration": first.elapsed,
            "measured": first.duration,
            "latitude_deg": self.latitude_deg,
            "horizontal_rate": first.horizontal_rate,
            "gyros": [_gyro_json(gyro) for gyro in self.gyros],
            "warnings": list(self.warnings),
            "advice": programme_json(first),
        }
        if self.calibration:
            summary["calibration"] = {node: dict(used) for node, used in self.calibration.items()}
        if self.output is not None:
            summary["output"] = self.output
        if self.east is not None and self.east_table_angle is not None:
            summary["east"] = {
                "table_angle_deg": math.degrees(self.east_table_angle) % 360,
                "steps": [
                    {"axis_angle_deg": math.degrees(step.angle), "rate": step.rate}
                    for step in self.east.steps
                ],
            }
        if self.simulated_azimuth is not None:
            summary["simulated_azimuth_deg"] = math.degrees(self.simulated_azimuth) % 360
            summary["error_deg"] = math.degrees(float(wrap_angle(self.azimuth - self.simulated_azimuth)))
        return summary

    def render(self, console: Console) -> None:
        """Print the azimuth, each gyro with the classical filters, and advice for the next measurement.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        console.print(
            f"azimuth of table zero {self.describe_azimuth(3)} clockwise from north", soft_wrap=True
        )
        if self.simulated_azimuth is not None:
            error = float(wrap_angle(self.azimuth - self.simulated_azimuth))
            true = angle_text(self.simulated_azimuth % math.tau, ".3f")
            console.print(f"simulated table at {true}: error {angle_text(error, '+.3f')}")
        if self.east_table_angle is not None:
            console.print(
                f"the axis points east with the table at "
                f"{angle_text(self.east_table_angle % math.tau, '.2f')}, "
                "its present position"
            )
        for north in self.gyros:
            drift = north.posterior.drift
            title = f"{north.name}, {north.method}"
            print_table(console, ("", *rate_headings()), estimate_rows(north, 3), title)
            console.print(
                f"{north.duration:.0f} s measured in {north.elapsed:.0f} s; {describe_white_bound(north)}; "
                f"fitted {', '.join(f'{name} {value}' for name, value in noise_rows(drift))}",
                highlight=False,
            )
            test, rate = north.earth_rate, RATE.shown()
            console.print(
                f"measured Earth rate {rate.number(test.measured, '.2f')} ± "
                f"{rate.number(test.sigma, '.2f')} {rate.name}, at this latitude "
                f"{rate.number(test.demanded, '.2f')} {rate.name}: chi-square {test.chi_square:.1f}, "
                f"probability {test.probability:.2g}",
                highlight=False,
            )
            if explanation := explain_sigma_below_bound(north):
                print_lines(console, [explanation], label="note")
        print_lines(console, describe_programmes(self.gyros[0]))
        print_lines(console, self.warnings, label="warning")
        if self.output is not None:
            print_lines(console, [f"recorded to {self.output}"])

    def __repr__(self) -> str:
        return f"NorthResult(table zero at {self.describe_azimuth(2)})"

    def _repr_html_(self) -> str:
        tables = [html_table(("", *rate_headings()), estimate_rows(gyro, 3)) for gyro in self.gyros]
        return html_lines((repr(self),)) + "".join(tables) + html_lines(self.warnings)


def _gyro_json(estimate: NorthEstimate) -> dict[str, Any]:
    """Return the JSON form of one gyro's result; angles in degrees, rates in rad/s, N, B, K in SI."""
    drift, ergodicity = (
        estimate.posterior.drift,
        fit_ergodicity(estimate.rates, neighbours_overlap=bool(estimate.stops)),
    )
    components, sigmas = estimate.rate_components()
    return {
        "node": estimate.node,
        "axis": estimate.axis,
        "method": estimate.method,
        "azimuth_deg": math.degrees(estimate.azimuth) % 360,
        "sigma_deg": math.degrees(estimate.sigma),
        "candidates_deg": [math.degrees(c) % 360 for c in estimate.candidates],
        "bound_deg": _finite(math.degrees(estimate.bound)),
        "white_noise_bound_deg": _finite(math.degrees(estimate.white_bound)),
        "bound_note": explain_sigma_below_bound(estimate) or None,
        "earth_rate": {
            "measured": estimate.earth_rate.measured,
            "sigma": estimate.earth_rate.sigma,
            "demanded": estimate.earth_rate.demanded,
            "chi_square": estimate.earth_rate.chi_square,
            "probability": estimate.earth_rate.probability,
        },
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


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
