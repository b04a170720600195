"""From a log and a model to the problem they pose: nodes, inputs and the time that both have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.gap.problem.log_inputs import input_noises, log_temperature, read_inputs, trace
from hubodo.gap.problem.plausible import check
from hubodo.gap.problem.problem import CHANNELS, NodeData, Problem
from hubodo.model.forward import NodeModel
from hubodo.model.inputs import MotionInputs
from hubodo.model.model_file import Model
from hubodo.recording import NODE_OPTIONAL_COLUMNS, Recording, Table
from hubodo.smoothing_spline import constant_spline
from hubodo.time_gaps import check_time_gaps

# s: shorter logs show too few turns and stops.
SHORTEST = 20.0
# A node with fewer samples is left out.
_LEAST_SAMPLES = 100
# So many equal largest readings are no chance.
_PILED = 6
_OWN_YAW = (
    "the yaw rate is what the gyros across the axles read: an error that all of them share cannot be seen "
    "or passes for one of the track width; a reference or a node on the body would show it"
)


def build(recording: Recording, model: Model, where: str = "log") -> Problem:
    """The problem that a recording poses to a model.

    Raises InputError when the log lacks what the model needs, is shorter than 20 s, has no node of the model,
    or cannot belong to it.
    """
    names = [name for name in model.vehicle.nodes if len(recording.nodes.get(name, ()))]
    if not names:
        raise InputError(
            f"{where}: has none of the model's nodes ({', '.join(model.vehicle.nodes) or 'it names none'}); "
            f"the log has {', '.join(recording.nodes) or 'no node'}; name them alike in [nodes], "
            "or say which topic is which with --topic"
        )
    for name, table in recording.files().items():
        if name in names or name == "reference":
            check_time_gaps(table.t, f"{where}: {name}")
    warnings = [f"{name}: not in the log" for name in model.vehicle.nodes if name not in names]
    origin = min(float(table.t[0]) for table in recording.files().values() if len(table))
    read = read_inputs(recording, model, origin, where)
    tables = {name: recording.nodes[name] for name in names}
    first = max(read.first, min(float(table.t[0]) - origin for table in tables.values()))
    last = min(read.last, max(float(table.t[-1]) - origin for table in tables.values()))
    if last - first < SHORTEST:
        raise InputError(
            f"{where}: nodes and inputs overlap for {max(last - first, 0.0):.1f} s; "
            f"at least {SHORTEST:.0f} s are needed"
        )
    speed = read.speed or constant_spline(float(model.inputs.speed), first, last)
    yaw_rate = read.yaw_rate or constant_spline(float(model.inputs.yaw_rate), first, last)
    inputs = MotionInputs(speed, yaw_rate, log_temperature(recording, names, origin))
    nodes = _nodes(tables, model, inputs, (origin, first, last), warnings)
    if not any(node.used.any() for node in nodes):
        raise InputError(f"{where}: no channel of any node changes; nothing was measured")
    if model.inputs.yaw_rate == "nodes":
        warnings.append(_OWN_YAW)
    warnings += check(nodes, inputs, read.measured_by, where)
    speed_noise, yaw_noise = input_noises(model, speed, yaw_rate, read.measured_by, warnings)
    return Problem(
        model,
        nodes,
        inputs,
        speed_noise,
        yaw_noise,
        read.speed_period,
        read.yaw_rate_period,
        last - first,
        read.measured_by,
        tuple(warnings),
    )


def _nodes(
    tables: Mapping[str, Table],
    model: Model,
    inputs: MotionInputs,
    span: tuple[float, float, float],
    warnings: list[str],
) -> tuple[NodeData, ...]:
    """The nodes with enough samples. span: s, when the log began, and the first and last time after that."""
    origin, first, last = span
    nodes = []
    for name, table in tables.items():
        inside = (table.t - origin >= first) & (table.t - origin <= last)
        t = np.ascontiguousarray(table.t[inside] - origin)
        if len(t) < _LEAST_SAMPLES:
            warnings.append(f"{name}: only {len(t)} samples while the inputs last; left out")
            continue
        y = np.stack([table[channel][inside] for channel in CHANNELS])
        mount = model.vehicle.nodes[name]
        used = np.ptp(y, axis=1) > 0.0
        still = [c for c, on in zip(CHANNELS, used, strict=True) if not on]
        if still:
            warnings.append(f"{name}: {', '.join(still)} never change; left out")
        if mount.side is not None and not used[3:5].all():
            used[[0, 1, 3, 4]] = False
            warnings.append(
                f"{name}: without ax and ay its wheel's angle is unknown; gx and gy are left out too"
            )
        warm, supply = (trace(table, column, origin) for column in NODE_OPTIONAL_COLUMNS)
        own = replace(inputs, temperature=warm or inputs.temperature, supply=supply or inputs.supply)
        forward = NodeModel(own, t, mount, model.vehicle.wheel_radius, model.vehicle.track_width)
        limits = (pile_up(y[:3]), pile_up(y[3:]))
        nodes.append(NodeData(name, mount, t, y, used, limits, forward))
    return tuple(nodes)


def pile_up(y: Array) -> float:
    """The limit, beyond which a triad reads nothing, (3, N): where its largest readings are all the same.

    Infinity where they are not.
    """
    values, counts = np.unique(np.abs(y), return_counts=True)
    # Noise spreads the largest readings: without a limit, fewer fall on the last value than on those before.
    if len(values) > 4 and counts[-1] >= _PILED and counts[-1] > 3 * counts[-4:-1].max():
        return float(values[-1])
    return np.inf
