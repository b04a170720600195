"""Estimation of north from turntable recordings: calibration, angles and estimate of each gyro axis."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from hubodo.calibration.apply import apply_calibration
from hubodo.calibration.file import Calibration
from hubodo.errors import InputError
from hubodo.fuse.ranges import determine_ranges, node_metadata
from hubodo.log.units import check_units
from hubodo.recording import Recording, Table
from hubodo.sensors.heading.estimate import UNCALIBRATED_SCALE_SIGMA
from hubodo.sensors.north.axis_record import AxisRecord, GyroAngleOptions, build_axis_record
from hubodo.sensors.north.circular import fuse_azimuths
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.measurements import Method
from hubodo.sensors.north.north_estimate import NorthEstimate, find_north, horizontal_earth_rate
from hubodo.sensors.north.result import NorthResult
from hubodo.vehicle import NodeMount

RecordSource = Callable[[Table, str], tuple[AxisRecord, list[str]]]
"""What makes the record of an axis from the table of its node, in place of the recorded motion."""


@dataclass(frozen=True)
class NorthOptions:
    """Options that the user gives for a measurement of north.

    Attributes:
        latitude_deg: latitude, north positive.
        axes: x, y or z of each node.
        method: how the table was moved.
        near_deg: approximate azimuth of table zero, degrees.
        settle: time cut off at both ends of each stop, s; detected if None.
        detect_stops: whether stops are detected even if the recording has a table.
        step_deg: the table stops only at multiples of this angle, degrees.
        scale_sigma: relative 1σ of the gyro scale.
        calibration: calibration of the nodes.
        drift: drift noise of the axis.
        stated_units: quantities whose unit the user gave.
        source: function that returns the record of an axis; None to use the recordings themselves.
    """

    latitude_deg: float
    axes: Sequence[str] = ("x",)
    method: Method = "maytag"
    near_deg: float | None = None
    settle: float | None = None
    detect_stops: bool = False
    step_deg: float | None = None
    scale_sigma: float | None = None
    calibration: Calibration | None = None
    drift: DriftNoise | None = None
    stated_units: Iterable[str] = ()
    source: RecordSource | None = None


def north_from_recordings(
    recordings: Sequence[tuple[str, Recording]],
    nodes: Sequence[str],
    options: NorthOptions,
    show: Callable[[str, float], None] = lambda text, share: None,
) -> NorthResult:
    """Return the azimuth of table zero from recordings between which the table's base was not moved.

    recordings: recordings with the names of their logs. show: callback for progress. Raises InputError for a
    missing node or axis, a wrong unit, or too few stops.
    """
    horizontal_earth_rate(math.radians(options.latitude_deg))
    requested = [(node, axis) for node in nodes for axis in options.axes]
    gyros: list[NorthEstimate] = []
    warnings: list[str] = []
    corrected: list[Mapping[str, Table]] = []
    used: dict[str, Any] = {}
    for log, recording in recordings:
        check_units(recording, nodes, log, options.stated_units)
        tables, applied, notes = _calibrated_tables(log, recording, nodes, options.calibration)
        corrected.append(tables)
        used |= applied
        warnings += notes
    for node, axis in requested:
        show(f"{node} {axis}", len(gyros) / len(requested))
        records = []
        for (_, recording), tables in zip(recordings, corrected, strict=True):
            record, notes = _axis_record(recording, tables[node], node, axis, options, len(recordings))
            records.append(record)
            warnings += [f"{node} {axis}: {text}" for text in notes]
        near = None if options.near_deg is None else math.radians(options.near_deg)
        estimate = find_north(
            records,
            math.radians(options.latitude_deg),
            options.method,
            settle=options.settle,
            near=near,
            drift=options.drift,
        )
        gyros.append(replace(estimate, node=node, axis=axis))
        warnings += [f"{node} {axis}: {text}" for text in estimate.warnings]
    azimuth, sigma = _combine(gyros)
    notes = list(dict.fromkeys(warnings))
    return NorthResult(options.latitude_deg, azimuth, sigma, tuple(gyros), tuple(notes), used)


def _combine(gyros: Sequence[NorthEstimate]) -> tuple[float, float]:
    """Return azimuth and sigma of all axes together, rad."""
    if len(gyros) == 1:
        return gyros[0].azimuth, gyros[0].sigma
    return fuse_azimuths(
        [(north.posterior, north.horizontal_rate) for north in gyros],
        max(north.angle_sigma for north in gyros),
    )


def _calibrated_tables(
    log: str, recording: Recording, nodes: Sequence[str], calibration: Calibration | None
) -> tuple[Mapping[str, Table], Mapping[str, Any], list[str]]:
    """Return the calibrated tables of the nodes, the calibration as applied, and warnings."""
    for node in nodes:
        if node not in recording.nodes:
            raise InputError(f"{log}: holds no node {node!r}; it has {', '.join(recording.nodes) or 'none'}")
        if calibration is not None and node not in calibration.nodes:
            known = ", ".join(calibration.nodes) or "none"
            raise InputError(f"--calibration holds no node {node!r}; it has {known}")
    tables = {node: recording.nodes[node] for node in nodes}
    if calibration is None:
        return tables, {}, []
    applied = apply_calibration(
        tables,
        calibration,
        metadata=recording.metadata,
        events=recording.events,
        t_zero_ns=recording.t_zero_ns,
    )
    return applied.nodes, applied.summaries, list(applied.warnings)


def _axis_record(
    recording: Recording, node: Table, name: str, axis: str, options: NorthOptions, n_recordings: int
) -> tuple[AxisRecord, list[str]]:
    """Return the record of one axis: with the given table angles, with detected ones, or from the source."""
    if options.source is not None:
        return options.source(node, axis)
    table = None if options.detect_stops else recording.table
    if table is None and options.method == "carousel":
        raise InputError(
            "a carousel needs table.csv (t,angle,moving): the gyro alone does not give its angle"
        )
    if table is None and n_recordings > 1:
        raise InputError("several logs can be combined only if table.csv gives their angles")
    step = None if options.step_deg is None else math.radians(options.step_deg)
    ranges = determine_ranges(NodeMount(), node_metadata(recording.metadata, name), recording.nodes[name])
    limit = ranges.clipping_limits["gyro_limit"]
    detection = GyroAngleOptions(_scale_sigma(options, name), step, limit)
    return build_axis_record(node, axis, table, math.radians(options.latitude_deg), detection)


def _scale_sigma(options: NorthOptions, node: str) -> float:
    """Return the relative 1σ of the gyro scale: as given, else calibrated, else typical of MEMS gyros."""
    if options.scale_sigma is not None:
        return float(options.scale_sigma)
    calibration = options.calibration
    if calibration is not None and "gyro_scale_factor" in calibration.nodes[node].effects:
        known = calibration.nodes[node].effects["gyro_scale_factor"].parameters.values()
        return max(quantity.sigma for quantity in known)
    return UNCALIBRATED_SCALE_SIGMA
