"""The result of `hubodo north`: as JSON, and as text and tables on a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hubodo.arrays import Array
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.east import EastSeekResult
from hubodo.sensors.north.north_estimate import NorthEstimate
from hubodo.sensors.north.result_json import describe_programmes, gyro_json, programme_json


@dataclass(frozen=True)
class NorthResult:
    """The azimuth of table zero from one axis, or from several axes combined.

    Attributes
    ----------
    latitude_deg
        Latitude, degrees.
    azimuth, sigma
        Azimuth of table zero clockwise from north and its sigma, rad.
    gyros
        Node, axis and north estimate of each gyro.
    warnings
        One line each.
    calibration
        Calibration that was applied, by node.
    simulated_azimuth
        True azimuth of a simulated table, rad.
    output
        Path of the log of a live run.
    east, east_table_angle
        Steps of the east-seeking loop, and its final table angle, rad.
    """

    latitude_deg: float
    azimuth: float
    sigma: float
    gyros: tuple[tuple[str, str, NorthEstimate], ...]
    warnings: tuple[str, ...]
    calibration: Mapping[str, Mapping[str, Any]]
    simulated_azimuth: float | None = None
    output: str | None = None
    east: EastSeekResult | None = None
    east_table_angle: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result: angles in degrees, rates in rad/s, times in s."""
        first = self.gyros[0][2]
        summary: dict[str, Any] = {
            "azimuth_deg": math.degrees(self.azimuth) % 360,
            "sigma_deg": math.degrees(self.sigma),
            "rate": [float(r) for r in first.rates],
            "duration": first.elapsed,
            "measured": first.duration,
            "latitude_deg": self.latitude_deg,
            "horizontal_rate": first.horizontal_rate,
            "gyros": [gyro_json(*gyro) for gyro in self.gyros],
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
        """Print the azimuth, each gyro with the classical filters, and advice for the next measurement."""
        console.print(
            f"azimuth of table zero {math.degrees(self.azimuth) % 360:.3f}° ± "
            f"{math.degrees(self.sigma):.3f}° "
            "clockwise from north"
        )
        if self.simulated_azimuth is not None:
            error = math.degrees(float(wrap_angle(self.azimuth - self.simulated_azimuth)))
            console.print(
                f"simulated table at {math.degrees(self.simulated_azimuth) % 360:.3f}°: error {error:+.3f}°"
            )
        if self.east_table_angle is not None:
            console.print(
                f"the axis points east with the table at {math.degrees(self.east_table_angle) % 360:.2f}°, "
                "its present position"
            )
        for node, axis, north in self.gyros:
            drift = north.posterior.drift
            table = Table("", "rate, °/h", "sigma, °/h", "azimuth, °", title=f"{node} {axis}, {north.method}")
            rate, spread = north.rate_components()
            table.add_row("maximum likelihood", _deg_h(rate), _deg_h(spread), _degrees(north.azimuth))
            for name, filtered in north.filters.items():
                cells = (
                    _deg_h(np.array(filtered.rate)),
                    _deg_h(np.array(filtered.sigma)),
                    _degrees(filtered.azimuth),
                )
                table.add_row(name.replace("_", " "), *cells)
            console.print(table)
            console.print(
                f"{north.duration:.0f} s measured in {north.elapsed:.0f} s; white noise alone would give "
                f"{math.degrees(north.white_bound):.3f}°; fitted N {math.degrees(drift.n) * 60:.3g} °/√h, "
                f"B {math.degrees(drift.b) * 3600:.3g} °/h, K {math.degrees(drift.k) * 3600 * 60:.3g} °/h/√h",
                highlight=False,
            )
        for line in describe_programmes(self.gyros[0][2]):
            console.print(line, highlight=False)
        for text in self.warnings:
            console.print(f"warning: {text}", highlight=False)
        if self.output is not None:
            console.print(f"recorded to {self.output}", highlight=False)


def _deg_h(values: Array) -> str:
    return ", ".join(f"{math.degrees(v) * 3600:.3f}" for v in values)


def _degrees(angle: float | None) -> str:
    return "" if angle is None else f"{math.degrees(angle) % 360:.2f}"
