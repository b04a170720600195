"""Sections of the drive on the page of a log: path, speed, vehicle, estimated parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hubodo.calibration.apply import AppliedCalibration
from hubodo.calibration.parameter_table import format_with_sigma
from hubodo.errors import InputError
from hubodo.fuse.track import format_error, score_track
from hubodo.fuse.wheel_odometry import WheelOdometry, compute_wheel_odometry
from hubodo.pages.curves import Curve, draw_curves
from hubodo.pages.drawing import Drawing
from hubodo.pages.page import COLOURS, PageTable, Section
from hubodo.recording import Recording
from hubodo.vehicle import Vehicle
from hubodo.vehicle_sketch import draw_vehicle


def drive_sections(
    name: str,
    recording: Recording,
    vehicle: Vehicle | None,
    applied: AppliedCalibration | None,
    facts: list[str],
    missing: list[str],
) -> list[Section]:
    """Return path, vehicle and estimated parameters of a log, or nothing if it cannot be fused.

    applied: the calibration in use. Results are appended to `facts`, what cannot be computed to `missing`.
    """
    if vehicle is None:
        missing.append("drive: no vehicle file in the log and none given (--vehicle)")
        return []
    nodes = recording if applied is None else _with_nodes(recording, applied)
    remaining = None if applied is None else applied.remaining
    try:
        odometry = compute_wheel_odometry(nodes, vehicle, log=name, calibration=remaining)
    except InputError as error:
        missing.append(f"drive: {error}")
        return []
    estimates = odometry.details
    facts.append(f"drive of {float(estimates['distance']):.2f} m by {odometry.method}")
    if float(estimates["distance"]) < 1.0:
        missing.append("drive: the wheels hardly turned, so the path is meaningless")
    grid = PageTable(("node", "quantity", "value ± 1σ"), _estimate_rows(estimates))
    text = " ".join(f"Note: {line}." for line in odometry.warnings)
    report = None
    truth = recording.truth
    if truth is not None:
        report = score_track(odometry.track, truth.t, truth["x"], truth["y"], truth.columns.get("heading"))
    if report is None:
        missing.append("drive: position error, because the log contains no truth")
    else:
        facts.append(
            "position error at the end "
            f"{format_error(report.final_error, report.final_percent, ' of the path')}"
        )
    estimated = Section(
        "Estimated parameters", "Of the wheel filter, at the end of the log.", [grid], is_folded=True
    )
    return [
        Section("Drive", text, figures=[_path(odometry, recording), _speed(odometry)]),
        Section("Vehicle", listing="\n".join(draw_vehicle(vehicle)), is_folded=True),
        estimated,
    ]


def _with_nodes(recording: Recording, applied: AppliedCalibration) -> Recording:
    named: dict[str, Any] = {
        key: getattr(recording, key)
        for key in ("reference", "wheels", "gnss", "heading", "table", "truth", "metadata", "t_zero_ns")
    }
    return Recording(applied.nodes, events=recording.events, warnings=recording.warnings, **named)


def _estimate_rows(estimates: Mapping[str, Any]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    groups = {"vehicle": estimates.get("vehicle", {}), **estimates.get("nodes", {})}
    for name, effects in groups.items():
        for effect, parameters in effects.items():
            for parameter, entry in parameters.items():
                value = format_with_sigma(entry["value"], entry["sigma"])
                rows.append((name, f"{effect}.{parameter}", value))
    return rows


def _path(odometry: WheelOdometry, recording: Recording) -> Drawing:
    shown = [Curve(odometry.track.x, odometry.track.y, "odometry", COLOURS["fused"], 2.0)]
    if recording.truth is not None:
        truth = recording.truth
        shown.insert(0, Curve(truth["x"], truth["y"], "truth", COLOURS["truth"], 5.0))
    return draw_curves(shown, "x, m", "y, m", height=4.6, equal=True)


def _speed(odometry: WheelOdometry) -> Drawing:
    track = odometry.track
    speed = Curve(track.t, track.speed, "speed", COLOURS["fused"])
    heading = Curve(track.t, np.degrees(track.heading), "heading", COLOURS["left"])
    return draw_curves([speed], "time, s", "speed, m/s", right=("heading, °", [heading]))
