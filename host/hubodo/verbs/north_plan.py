"""`hubodo north --plan`: which stops a gyro needs, from its Allan curve, before a table turns."""

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
from hubodo.sensors.at_rest import check_still, check_units
from hubodo.sensors.north.advice import Advice
from hubodo.sensors.north.drift import Drift
from hubodo.sensors.north.find import horizontal_rate
from hubodo.sensors.north.plan import StopPlan, drift_at_rest, drift_of_allan, plan
from hubodo.verbs.log_options import log_form


@dataclass(frozen=True)
class Planned:
    """The programmes of one axis, and what sigma was asked for."""

    latitude_deg: float
    sigma_deg: float
    turn: float
    plan: StopPlan

    def as_json(self) -> dict[str, Any]:
        """Times in s, angles in degrees, N, B, K in SI."""
        drift = self.plan.drift
        return {
            "latitude_deg": self.latitude_deg,
            "turn": self.turn,
            "drift": {"N": drift.n, "B": drift.b, "K": drift.k},
            "best": [
                {**_advice(advice), "white_noise_bound_deg": math.degrees(bound)}
                for advice, bound in self.plan.best
            ],
            "wanted_sigma_deg": self.sigma_deg,
            "wanted": None if self.plan.wanted is None else _advice(self.plan.wanted),
        }

    def render(self, console: Console) -> None:
        """What to do for the sigma that was asked for, then the best of each time."""
        wanted = self.plan.wanted
        console.print(
            f"{self.sigma_deg:g}° cannot be reached within a day with this gyro"
            if wanted is None
            else f"{self.sigma_deg:g}° takes {wanted.time / 60:.0f} minutes: {wanted.count} stops of "
            f"{wanted.stop:g} s at 0, 180, 90, 270 degrees (sigma {math.degrees(wanted.sigma):.2f}°)",
            highlight=False,
        )
        table = Table("minutes", "stops", "of, s", "sigma, °", "white noise alone, °")
        for advice, bound in self.plan.best:
            table.add_row(
                f"{advice.time / 60:.0f}",
                str(advice.count),
                f"{advice.stop:g}",
                f"{math.degrees(advice.sigma):.2f}",
                f"{math.degrees(bound):.2f}",
            )
        console.print(table)


def run_plan(args: argparse.Namespace) -> Planned:
    """Noise from `--allan`, or from a LOG at rest. Raises InputError without either."""
    horizontal = horizontal_rate(math.radians(args.latitude_deg))
    sigma_deg = 1.0 if args.sigma_deg is None else args.sigma_deg
    if args.allan is None and len(args.log) != 1:
        raise InputError("--plan needs the gyro's noise: give --allan JSON, or one LOG at rest")
    drift = _at_rest(args) if args.allan is None else drift_of_allan(args.allan)
    found = plan(drift, horizontal, math.radians(sigma_deg), args.turn)
    return Planned(args.latitude_deg, sigma_deg, args.turn, found)


def _at_rest(args: argparse.Namespace) -> Drift:
    log = args.log[0]
    with progress_line() as show:
        nodes = read_log(log, input_format=log_form(args, needed=()), progress=show).nodes
    name = str(args.node[0]) if args.node else next(iter(nodes)) if len(nodes) == 1 else ""
    if name not in nodes:
        raise InputError(f"{log}: say --node with one of: {', '.join(nodes) or 'none'}")
    node, axis = nodes[name], (args.axis or ["x"])[0]
    try:
        check_units(node.gyro, node.accel)
        check_still(node.t, np.column_stack([node.gyro, node.accel]))
        return drift_at_rest(node.t, node["g" + axis].copy(), "g" + axis)
    except InputError as error:
        raise InputError(f"{log}, {name} g{axis}: {error}") from None


def _advice(advice: Advice) -> dict[str, float]:
    return {
        "stop": advice.stop,
        "stops": advice.count,
        "time": advice.time,
        "sigma_deg": math.degrees(advice.sigma),
    }
