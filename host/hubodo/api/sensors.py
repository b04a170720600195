"""Heading, north and rate-table calibration of a log in memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.api.arguments import StrPath, as_calibration
from hubodo.errors import InputError
from hubodo.log.rate_file import read_rate_file
from hubodo.log.units import check_node_units
from hubodo.sensors.heading.estimate import HeadingOptions, effects_of_node, heading_from_recording
from hubodo.sensors.heading.prior import read_bias_noise
from hubodo.sensors.heading.result import HeadingResult
from hubodo.sensors.north.from_recordings import NorthOptions, north_from_recordings
from hubodo.sensors.north.measurements import METHODS
from hubodo.sensors.north.measurements import Method as NorthMethod
from hubodo.sensors.north.plan import read_drift_noise
from hubodo.sensors.north.result import NorthResult
from hubodo.sensors.rate_table.calibrate import RateOptions, calibrate_node_rate
from hubodo.sensors.rate_table.result import RateCalibration

if TYPE_CHECKING:
    from hubodo.api.sensor_methods import SensorMethods
    from hubodo.calibration.file import Calibration


def estimate_log_heading(
    log: SensorMethods,
    node: str,
    axis: str,
    calibration: StrPath | Calibration | None,
    allan: StrPath | None,
    age: float | None,
    standstills: Sequence[tuple[float, float]],
    scale_sigma: float | None,
    lag: float | None,
    step: float,
) -> HeadingResult:
    """Return the heading of a node; parameters as in `LoadedLog.heading`."""
    if axis not in ("x", "y", "z"):
        raise InputError(f"axis {axis!r}: choose from x, y, z")
    if not 1e-3 <= step <= 60.0:
        raise InputError(f"step = {step}: give 0.001 to 60 s")
    read, file = as_calibration(calibration)
    source = "the calibration" if file is None else file["file"]
    where = f"{log.path}, node {node}"
    check_node_units(log.recording.nodes[node], where)
    try:
        options = HeadingOptions(
            axis=axis,
            effects={} if read is None else effects_of_node(read, node, source),
            noise=None if allan is None else read_bias_noise(Path(allan)),
            age=age,
            standstills=standstills,
            scale_sigma=scale_sigma,
            lag=lag,
            step=step,
        )
        return heading_from_recording(log.recording, node, options, log=str(log.path))
    except InputError as error:
        raise InputError(f"{where}, {axis}: {error}") from None


def calibrate_log_rate(
    log: SensorMethods,
    node: str,
    axis: str,
    rates_deg_s: Sequence[float],
    table: StrPath | None,
    settle: float,
    min_plateau: float,
    full_scale_deg_s: float | None,
    latitude_deg: float | None,
) -> RateCalibration:
    """Return the calibration of an axis on a rate table; parameters as in `LoadedLog.calibrate_rate`."""
    if axis not in ("x", "y", "z"):
        raise InputError(f"axis {axis!r}: choose from x, y, z")
    if (table is None) == (len(rates_deg_s) == 0):
        raise InputError("the rates of the table are needed: give either table or rates_deg_s")
    for name, value in (("settle", settle), ("min_plateau", min_plateau)):
        if not 0.0 <= value < math.inf:
            raise InputError(f"{name} = {value}: give a time of 0 s or more")
    if full_scale_deg_s is not None and not 0.0 < full_scale_deg_s < math.inf:
        raise InputError(f"full_scale_deg_s = {full_scale_deg_s}: give a rate above 0")
    if latitude_deg is not None and not -90.0 <= latitude_deg <= 90.0:
        raise InputError(f"latitude_deg = {latitude_deg}: give -90 to 90 degrees")
    options = RateOptions(
        [math.radians(rate) for rate in rates_deg_s],
        None if table is None else read_rate_file(Path(table)),
        settle,
        min_plateau,
        None if full_scale_deg_s is None else math.radians(full_scale_deg_s),
        None if latitude_deg is None else math.radians(latitude_deg),
    )
    return calibrate_node_rate(log.recording.nodes[node], node, axis, str(log.path), options)


def find_log_north(
    log: SensorMethods,
    node: str,
    axis: str,
    *,
    latitude_deg: float,
    method: NorthMethod,
    near_deg: float | None,
    calibration: StrPath | Calibration | None,
    allan: StrPath | None,
    settle: float | None,
    find_stops: bool,
    scale_sigma: float | None,
) -> NorthResult:
    """Return the azimuth of table zero from a node; parameters as in `LoadedLog.north`."""
    if axis not in ("x", "y", "z"):
        raise InputError(f"axis {axis!r}: choose from x, y, z")
    if method not in METHODS:
        raise InputError(f"method {method!r}: choose from {', '.join(METHODS)}")
    if scale_sigma is not None and not 0.0 < scale_sigma <= 0.2:
        raise InputError(f"scale_sigma = {scale_sigma}: give a fraction above 0, up to 0.2")
    options = NorthOptions(
        latitude_deg,
        (axis,),
        method,
        near_deg,
        settle,
        find_stops,
        None,
        scale_sigma,
        as_calibration(calibration)[0],
        None if allan is None else read_drift_noise(Path(allan)),
    )
    return north_from_recordings([(str(log.path), log.recording)], [node], options)
