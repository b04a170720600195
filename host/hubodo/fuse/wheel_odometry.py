"""Odometry of a recording: the wheel filter, or plain differential odometry for comparison."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np

from hubodo.calibration.apply import apply_calibration
from hubodo.calibration.file import Calibration
from hubodo.errors import InputError
from hubodo.fuse.differential_odometry import OdometryConfig, integrate_wheels
from hubodo.fuse.graph.factors.constants import (
    ConstantSigmas,
    sigmas_for_wheel_filter,
    sigmas_for_wheel_speeds,
)
from hubodo.fuse.latitude import add_latitude, latitude_warnings
from hubodo.fuse.ranges import NodeRanges
from hubodo.fuse.rolling_wheel import WheelSamples, WheelSpec
from hubodo.fuse.spikes import remove_spikes
from hubodo.fuse.track import Track, track_from_states
from hubodo.fuse.wheel.config import add_node_biases, wheel_config
from hubodo.fuse.wheel.entries import GYRO_SCALE_ACROSS, WHEEL_RADIUS, YAW_RATE_FROM_GRAVITY
from hubodo.fuse.wheel.node_screening import check_times, screen_samples
from hubodo.fuse.wheel.surface_speeds import average_surface_speeds
from hubodo.fuse.wheel.track import WheelRun, run_wheel_filter
from hubodo.fuse.wheel.window import WINDOW_S
from hubodo.fuse.wheel_nodes import (
    determine_log_ranges,
    extend_ranges,
    missing_node_warnings,
    select_wheel_nodes,
    steering_warnings,
)
from hubodo.recording import Recording, Table
from hubodo.vehicle import Side, Vehicle

Method = Literal["filter", "differential"]
METHODS: tuple[Method, ...] = ("filter", "differential")
_MIN_NODE_SAMPLES = 20
"""A fifth of a second; a node with fewer samples counts as missing."""
SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True)
class WheelOdometry:
    """A track from wheel nodes, with the estimator's results that a graph and fuse.json need.

    Attributes
    ----------
    track : poses with sigmas.
    nodes : names of the nodes used.
    method : name of the estimator, for people.
    details : entries of fuse.json: distance, duration, estimated parameters, slips.
    warnings : one line each.
    constant_sigmas : prior sigmas of the odometry's constant errors, for the graph.
    """

    track: Track
    nodes: tuple[str, ...]
    method: str
    details: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
    constant_sigmas: ConstantSigmas = field(default_factory=sigmas_for_wheel_speeds)


def read_start_heading(recording: Recording, t: float) -> float | None:
    """Return the heading of truth or compass at time t, rad; None where the log has neither."""
    for table in (recording.truth, recording.heading):
        if table is not None and "heading" in table:
            return float(np.interp(t, table.t, np.unwrap(table["heading"])))
    return None


def compute_wheel_odometry(
    recording: Recording,
    vehicle: Vehicle,
    *,
    log: str,
    method: Method = "filter",
    nodes: Sequence[str] | None = None,
    calibration: Calibration | None = None,
    lag: float = 0.0,
    for_graph: bool = False,
) -> WheelOdometry:
    """Return the track of one or two wheel nodes, starting at the heading that the log gives, else at 0.

    Wheel speeds of another sensor are measurements of the wheel filter; in a recording without the vehicle's
    nodes they give the track alone.

    lag: s by which the samples used for a pose may be later than it; inf for the whole log. for_graph:
    whether a graph uses the whole log anyway; a slip that was detected late is then smoothed. calibration:
    applied to the samples; parameters that only the filter can use become its prior, as does the bias
    reported by a node's firmware if the calibration has none. Raises InputError for missing nodes, two nodes
    on one wheel, and a log that is too short, CalibrationError for a calibration of another node.
    """
    if (
        recording.wheels is not None
        and not nodes
        and not any(name in recording.nodes for name, mount in vehicle.nodes.items() if mount.side)
    ):
        return _run_on_wheel_speeds(recording, vehicle, recording.wheels)
    names = select_wheel_nodes(recording, vehicle, nodes, log)
    check_times({name: recording.nodes[name] for name in names}, log)
    recording, spike_warnings = remove_spikes(recording, names)
    ranges = determine_log_ranges(recording, vehicle, names, corrected=calibration is not None)
    recording = extend_ranges(recording, ranges)
    applied = None
    if calibration is not None:
        applied = apply_calibration(
            recording.nodes,
            calibration,
            metadata=recording.metadata,
            events=recording.events,
            t_zero_ns=recording.t_zero_ns,
        )
        recording, calibration = replace(recording, nodes=applied.nodes), applied.remaining
    if method == "differential":
        return _run_differential(recording, vehicle, names, log)
    calibration, reporting_nodes = add_node_biases(calibration, recording, names)
    odometry = _run_wheel_filter(recording, vehicle, names, log, calibration, ranges, lag, for_graph)
    if reporting_nodes:
        odometry = replace(odometry, details={**odometry.details, "bias_from_node": list(reporting_nodes)})
    warnings = (
        spike_warnings + odometry.warnings + missing_node_warnings(recording, vehicle, odometry.nodes, nodes)
    )
    if applied is None:
        return replace(odometry, warnings=warnings)
    learnt = (
        {**odometry.details, "calibrated": dict(applied.summaries)} if applied.summaries else odometry.details
    )
    return replace(odometry, warnings=applied.warnings + warnings, details=learnt)


def _run_wheel_filter(
    recording: Recording,
    vehicle: Vehicle,
    names: tuple[str, ...],
    log: str,
    calibration: Calibration | None,
    ranges: Mapping[str, NodeRanges],
    lag: float,
    for_graph: bool,
) -> WheelOdometry:
    """Run the wheel filter on nodes whose samples are already calibrated."""
    used_nodes, screenings = screen_samples({name: recording.nodes[name] for name in names})
    names = tuple(name for name in names if len(used_nodes[name]) > _MIN_NODE_SAMPLES) or names
    try:
        # The filter begins at the first edge of a window.
        first = min(table.t[0] for table in used_nodes.values() if len(table))
        first = math.ceil(first / WINDOW_S - 1e-9) * WINDOW_S
        config = wheel_config(add_latitude(vehicle, recording), list(names), calibration, ranges)
        config = replace(config, start_heading=read_start_heading(recording, first) or 0.0)
        speeds = None if recording.wheels is None else average_surface_speeds(recording.wheels)
        config = replace(config, encoder_aided=bool(speeds))
        # A step of the forward filter may contain a correction of earlier steps, which a graph would take for
        # motion.
        filter_lag = math.inf if for_graph and lag == 0.0 else lag
        result = run_wheel_filter(config, used_nodes, filter_lag, speeds)
    except ValueError as error:
        raise InputError("; ".join([f"{log}: {error}", *screenings])) from None
    report = result.report.as_json()
    report["ranges"] = {name: ranges[name].as_json() for name in names}
    range_warnings = tuple(f"{name}: {line}" for name in names for line in ranges[name].warnings)
    warnings = (
        screenings
        + latitude_warnings(vehicle, recording)
        + range_warnings
        + steering_warnings(vehicle, names, config.nodes)
        + tuple(report.pop("warnings"))
    )
    names = tuple(config.nodes)
    track = _with_start_pose(result.track, config.start_heading, config.heading_sigma)
    return WheelOdometry(
        track,
        names,
        report.pop("method"),
        report,
        warnings,
        constant_sigmas=graph_constant_sigmas(result),
    )


def graph_constant_sigmas(result: WheelRun) -> ConstantSigmas:
    """Return the prior sigmas of the constant errors in a track of the wheel filter."""
    core = result.filter.core
    scale = [core.estimate(wheel.name, GYRO_SCALE_ACROSS).sigma for wheel in core.wheels]
    radius = math.hypot(core.mean_sigma(WHEEL_RADIUS), core.common_scale_sigma)
    return sigmas_for_wheel_filter(radius, scale, core.mean_sigma(YAW_RATE_FROM_GRAVITY))


def _with_start_pose(track: Track, heading: float, sigma: float) -> Track:
    """Return the filter's track with its start prepended.

    The filter's first pose is the end of its first window.
    """
    start = {
        "t": track.t[0] - WINDOW_S,
        "heading": heading,
        "speed": track.speed[0],
        "yaw_rate": track.yaw_rate[0],
        "sigma_heading": sigma,
    }
    names = [item.name for item in fields(Track)]
    return Track(**{name: np.append(start.get(name, 0.0), getattr(track, name)) for name in names})


def _run_differential(
    recording: Recording, vehicle: Vehicle, names: Sequence[str], log: str
) -> WheelOdometry:
    """Run differential odometry on two nodes."""
    by_side = {vehicle.nodes[name].side: name for name in names}
    if set(by_side) != set(SIDES):
        raise InputError(f"{log}: differential odometry needs a node on each wheel; the filter does not")
    spec = {
        side: WheelSpec(vehicle.wheel_radius, vehicle.nodes[by_side[side]].facing or "left") for side in SIDES
    }
    samples = [_wheel_samples(side, recording.nodes[by_side[side]]) for side in SIDES]
    states = integrate_wheels(OdometryConfig(spec["left"], spec["right"], vehicle.track_width), samples)
    if not states:
        raise InputError(f"{log}: {' and '.join(names)} have no time in common; nothing to fuse")
    track = track_from_states(states, read_start_heading(recording, states[0].t_ns * 1e-9) or 0.0)
    learnt = {"distance": states[-1].distance, "duration": float(track.t[-1] - track.t[0])}
    return WheelOdometry(track, tuple(names), "differential odometry", learnt)


def _run_on_wheel_speeds(recording: Recording, vehicle: Vehicle, wheels: Table) -> WheelOdometry:
    """Run differential odometry (Shah et al. eq. 16) on the surface speeds of another odometer."""
    radius = vehicle.wheel_radius
    spec = WheelSpec(radius, "left", 0.0, 0.0)
    t_ns = np.round(wheels.t * 1e9).astype(np.int64)
    no_motion = np.zeros((len(wheels), 3))

    def samples_from_speed(side: Side) -> WheelSamples:
        gyro = no_motion.copy()
        gyro[:, 2] = wheels[side] / radius
        return WheelSamples(side, t_ns, gyro, no_motion)

    config = OdometryConfig(spec, spec, vehicle.track_width, estimate_bias=False)
    states = integrate_wheels(config, [samples_from_speed(side) for side in SIDES])
    if not states:
        raise InputError(f"wheels.csv: {len(wheels)} rows are too few for a track")
    track = track_from_states(states, read_start_heading(recording, states[0].t_ns * 1e-9) or 0.0)
    learnt = {"distance": states[-1].distance, "duration": float(track.t[-1] - track.t[0])}
    unused = [
        f"{name}: on no wheel of the vehicle file; the track comes from wheels.csv alone"
        for name in recording.nodes
    ]
    return WheelOdometry(track, (), "differential odometry on wheel speeds", learnt, tuple(unused))


def _wheel_samples(side: Side, table: Table) -> WheelSamples:
    return WheelSamples(side, np.round(table.t * 1e9).astype(np.int64), table.gyro, table.accel)
