"""`hubodo north --plan`: plan the stops for a gyro from its Allan deviation, before a table turns."""

from __future__ import annotations

import argparse

import numpy as np

from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.progress import progress_line
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.plan import StopPlan, drift_noise_from_standstill, plan_stops, read_drift_noise
from hubodo.sensors.standstill_checks import check_standstill, check_units
from hubodo.verbs.log_options import stated_input_format


def run_plan(args: argparse.Namespace) -> StopPlan:
    """Plan with the noise of `--allan` or of a stationary LOG; raise InputError without either."""
    sigma_deg = 1.0 if args.sigma_deg is None else args.sigma_deg
    if args.allan is None and len(args.log) != 1:
        raise InputError("--plan needs the gyro's noise: give --allan JSON, or one LOG of a stationary node")
    drift = _drift_from_log(args) if args.allan is None else read_drift_noise(args.allan)
    return plan_stops(drift, args.latitude_deg, sigma_deg, args.turn)


def _drift_from_log(args: argparse.Namespace) -> DriftNoise:
    log = args.log[0]
    with progress_line() as show:
        nodes = read_log(log, input_format=stated_input_format(args, needed=()), progress=show).nodes
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
