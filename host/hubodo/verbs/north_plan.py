"""`hubodo north --plan`: plan the stops for a gyro from its Allan deviation, before a table turns."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.progress import progress_line
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.north_estimate import horizontal_earth_rate
from hubodo.sensors.north.plan import StopPlan, drift_noise_from_standstill, plan_stops, read_drift_noise
from hubodo.sensors.north.programme import StopProgramme
from hubodo.sensors.standstill_checks import check_standstill, check_units
from hubodo.verbs.log_options import log_form


@dataclass(frozen=True)
class StopPlanResult:
    """The measurement plans of one axis.

    Attributes
    ----------
    latitude_deg
        Latitude, degrees.
    sigma_deg
        Requested sigma of the azimuth, degrees.
    turn
        Duration of a turn of the table, s.
    plan
        The shortest plan for the requested sigma, and the best plan for each duration.
    """

    latitude_deg: float
    sigma_deg: float
    turn: float
    plan: StopPlan

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result: times in s, angles in degrees, N, B, K in SI units."""
        drift = self.plan.drift
        return {
            "latitude_deg": self.latitude_deg,
            "turn": self.turn,
            "drift": {"N": drift.n, "B": drift.b, "K": drift.k},
            "best": [
                {**_advice_json(advice), "white_noise_bound_deg": math.degrees(bound)}
                for advice, bound in self.plan.programmes
            ],
            "wanted_sigma_deg": self.sigma_deg,
            "wanted": None
            if self.plan.target_programme is None
            else _advice_json(self.plan.target_programme),
        }

    def render(self, console: Console) -> None:
        """Print the plan for the requested sigma, then the best plan for each duration."""
        wanted = self.plan.target_programme
        console.print(
            f"{self.sigma_deg:g}° cannot be reached within a day with this gyro"
            if wanted is None
            else f"{self.sigma_deg:g}° takes {wanted.time / 60:.0f} minutes: {wanted.count} stops of "
            f"{wanted.stop:g} s at 0, 180, 90, 270 degrees (sigma {math.degrees(wanted.sigma):.2f}°)",
            highlight=False,
        )
        table = Table("minutes", "stops", "stop, s", "sigma, °", "white noise alone, °")
        for advice, bound in self.plan.programmes:
            table.add_row(
                f"{advice.time / 60:.0f}",
                str(advice.count),
                f"{advice.stop:g}",
                f"{math.degrees(advice.sigma):.2f}",
                f"{math.degrees(bound):.2f}",
            )
        console.print(table)


def run_plan(args: argparse.Namespace) -> StopPlanResult:
    """Plan with the noise of `--allan` or of a stationary LOG; raise InputError without either."""
    horizontal = horizontal_earth_rate(math.radians(args.latitude_deg))
    sigma_deg = 1.0 if args.sigma_deg is None else args.sigma_deg
    if args.allan is None and len(args.log) != 1:
        raise InputError("--plan needs the gyro's noise: give --allan JSON, or one LOG of a stationary node")
    drift = _drift_from_log(args) if args.allan is None else read_drift_noise(args.allan)
    stop_plan = plan_stops(drift, horizontal, math.radians(sigma_deg), args.turn)
    return StopPlanResult(args.latitude_deg, sigma_deg, args.turn, stop_plan)


def _drift_from_log(args: argparse.Namespace) -> DriftNoise:
    log = args.log[0]
    with progress_line() as show:
        nodes = read_log(log, input_format=log_form(args, needed=()), progress=show).nodes
    name = str(args.node[0]) if args.node else next(iter(nodes)) if len(nodes) == 1 else ""
    if name not in nodes:
        raise InputError(f"{log}: give --node with one of: {', '.join(nodes) or 'none'}")
    node, axis = nodes[name], (args.axis or ["x"])[0]
    try:
        check_units(node.gyro, node.accel)
        check_standstill(node.t, np.column_stack([node.gyro, node.accel]))
        return drift_noise_from_standstill(node.t, node["g" + axis].copy(), "g" + axis)
    except InputError as error:
        raise InputError(f"{log}, {name} g{axis}: {error}") from None


def _advice_json(advice: StopProgramme) -> dict[str, float]:
    return {
        "stop": advice.stop,
        "stops": advice.count,
        "time": advice.time,
        "sigma_deg": math.degrees(advice.sigma),
    }
