"""Construction of the problem from a log and a model: nodes, inputs and their common time span."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hubodo.errors import InputError
from hubodo.gap.problem.log_inputs import (
    estimate_input_noise,
    read_inputs,
    read_temperature,
    read_trace,
    yaw_rate_offset_sigma,
)
from hubodo.gap.problem.plausibility import check_plausibility
from hubodo.gap.problem.problem import CHANNELS, MIN_NODE_SAMPLES, NodeData, Problem
from hubodo.gap.problem.saturation import find_saturation_limit
from hubodo.model.forward import NodeModel
from hubodo.model.inputs import MotionInputs
from hubodo.model.model_file import Model
from hubodo.recording import NODE_OPTIONAL_COLUMNS, Recording, Table
from hubodo.smoothing_spline import constant_spline
from hubodo.time_gaps import check_time_gaps

# s, minimum duration; shorter logs contain too few turns and stops.
MIN_DURATION = 20.0
_SHARED_YAW_WARNING = (
    "the yaw rate comes from the gyro axes across the axles: an error common to all of them is not "
    "observable or looks like a track width error; a reference or a node on the body would show it"
)


def build_problem(recording: Recording, model: Model, log_name: str = "log") -> Problem:
    """Match a recording with a model.

    Raises InputError if the log lacks an input of the model, is shorter than 20 s, has no node of the model,
    or is not plausible for the model.
    """
    names = [name for name in model.vehicle.nodes if len(recording.nodes.get(name, ()))]
    if not names:
        raise InputError(
            f"{log_name}: has none of the model's nodes ({', '.join(model.vehicle.nodes) or 'none'}); "
            f"the log has {', '.join(recording.nodes) or 'no node'}; use the same names in [nodes], "
            "or assign topics with --topic"
        )
    for name, table in recording.files().items():
        if name in names or name == "reference":
            check_time_gaps(table.t, f"{log_name}: {name}")
    warnings = [f"{name}: not in the log" for name in model.vehicle.nodes if name not in names]
    origin = min(float(table.t[0]) for table in recording.files().values() if len(table))
    log_inputs = read_inputs(recording, model, origin, log_name)
    tables = {name: recording.nodes[name] for name in names}
    first = max(log_inputs.first, min(float(table.t[0]) - origin for table in tables.values()))
    last = min(log_inputs.last, max(float(table.t[-1]) - origin for table in tables.values()))
    if last - first < MIN_DURATION:
        raise InputError(
            f"{log_name}: nodes and inputs overlap for {max(last - first, 0.0):.1f} s; "
            f"at least {MIN_DURATION:.0f} s are needed"
        )
    speed = log_inputs.speed or constant_spline(float(model.inputs.speed), first, last)
    yaw_rate = log_inputs.yaw_rate or constant_spline(float(model.inputs.yaw_rate), first, last)
    inputs = MotionInputs(speed, yaw_rate, read_temperature(recording, names, origin))
    nodes = _build_nodes(tables, model, inputs, (origin, first, last), warnings)
    if not any(node.used.any() for node in nodes):
        raise InputError(f"{log_name}: no channel of any node changes; nothing was measured")
    if model.inputs.yaw_rate == "nodes":
        warnings.append(_SHARED_YAW_WARNING)
    warnings += check_plausibility(nodes, inputs, log_inputs.speed_sources, log_name)
    speed_noise, yaw_noise = estimate_input_noise(model, speed, yaw_rate, log_inputs.speed_sources, warnings)
    return Problem(
        model,
        nodes,
        inputs,
        speed_noise,
        yaw_noise,
        log_inputs.speed_period,
        log_inputs.yaw_rate_period,
        last - first,
        log_inputs.speed_sources,
        tuple(warnings),
        yaw_rate_offset_sigma(model),
    )


def _build_nodes(
    tables: Mapping[str, Table],
    model: Model,
    inputs: MotionInputs,
    span: tuple[float, float, float],
    warnings: list[str],
) -> tuple[NodeData, ...]:
    """Return the nodes with enough samples.

    span: s, start of the log, and first and last time relative to it
    """
    origin, first, last = span
    nodes = []
    for name, table in tables.items():
        inside = (table.t - origin >= first) & (table.t - origin <= last)
        t = np.ascontiguousarray(table.t[inside] - origin)
        if len(t) < MIN_NODE_SAMPLES:
            warnings.append(f"{name}: only {len(t)} samples while the inputs last; left out")
            continue
        readings = np.stack([table[channel][inside] for channel in CHANNELS])
        mount = model.vehicle.nodes[name]
        used = np.ptp(readings, axis=1) > 0.0
        unchanging = [c for c, on in zip(CHANNELS, used, strict=True) if not on]
        if unchanging:
            warnings.append(f"{name}: {', '.join(unchanging)} never change; left out")
        if mount.side is not None and not used[3:5].all():
            used[[0, 1, 3, 4]] = False
            warnings.append(
                f"{name}: without ax and ay its wheel's angle is unknown; gx and gy are left out too"
            )
        temperature, supply = (read_trace(table, column, origin) for column in NODE_OPTIONAL_COLUMNS)
        node_inputs = replace(
            inputs, temperature=temperature or inputs.temperature, supply=supply or inputs.supply
        )
        forward = NodeModel(node_inputs, t, mount, model.vehicle.wheel_radius, model.vehicle.track_width)
        saturation_limits = (find_saturation_limit(readings[:3]), find_saturation_limit(readings[3:]))
        nodes.append(NodeData(name, mount, t, readings, used, saturation_limits, forward))
    return tuple(nodes)
